export const PICTURE = /* glsl */ `
// Shades a surface whose gaps are filled, and finds its lines. lines.glsl.js and shading.glsl.js must precede this
// code.

uniform sampler2D albedo;
uniform vec3 paper;

layout(location = 0) out vec4 shaded;
layout(location = 1) out uint new_line_state;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 own = texelFetch(albedo, pixel, 0), packed_normal = texelFetch(closed_normal, pixel, 0);
    vec3 normal = packed_normal.w > 0.0 ? unpack_normal(packed_normal).xyz : vec3(0.0);
    vec3 captured = clamp(own.rgb / max(own.a, 1.0 / 255.0), 0.0, 1.0);
    vec3 colour = shade(pixel, captured, normal, texelFetch(closed_depth, pixel, 0).r);
    float coverage = own.a > 0.0 ? packed_normal.w : 0.0;
    shaded = vec4(paper + coverage * (colour - paper), coverage);
    new_line_state = find_line(pixel);
}
`;
