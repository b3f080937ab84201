// Keeps only the pixels in which a dual peeling pass has found layers, so that an occlusion query can count them. If
// `visible_only` is true, pixels are also dropped where the layers in `front` leave a transmittance below
// MIN_TRANSMITTANCE, because farther layers are invisible there.

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
