#version 330 core
// Keeps the pixels in which a dual peeling pass has found layers. If `visible_only` is true, a pixel is kept only if
// its next layer is visible through the layers in front. An occlusion query counts the kept pixels.

uniform sampler2D bounds;
uniform sampler2D front;
uniform bool visible_only;

out vec4 nothing;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    if (texelFetch(bounds, pixel, 0).r == -NONE) discard;
    if (visible_only && 1.0 - texelFetch(front, pixel, 0).a < MIN_TRANSMITTANCE) discard;
    nothing = vec4(0.0);
}
