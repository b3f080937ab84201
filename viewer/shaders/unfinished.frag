#version 330 core
// Keeps pixels with layers left between front and back; with `visible`, those alone whose next layer could be seen.

uniform sampler2D ends;
uniform sampler2D front;
uniform bool visible;

out vec4 nothing;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    if (texelFetch(ends, pixel, 0).r == -NONE) discard;
    if (visible && 1.0 - texelFetch(front, pixel, 0).a < HIDDEN) discard;
    nothing = vec4(0.0);
}
