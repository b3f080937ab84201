// Draws a closed surface in a style. lines.glsl and shading.glsl must precede this text, which is also valid GLSL ES 3.00.

uniform sampler2D albedo;
uniform float line_opacity;
uniform vec3 line_colour;
uniform vec3 paper;

layout(location = 0) out vec4 picture;
layout(location = 1) out uint new_line_state;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 own = texelFetch(albedo, pixel, 0), packed_normal = texelFetch(closed_normal, pixel, 0);
    vec3 normal = packed_normal.w > 0.0 ? unpack_normal(packed_normal).xyz : vec3(0.0);
    vec3 captured = clamp(own.rgb / max(own.a, 1.0 / 255.0), 0.0, 1.0);
    vec3 colour = shade(pixel, captured, normal, texelFetch(closed_depth, pixel, 0).r);
    float coverage = own.a > 0.0 ? packed_normal.w : 0.0, line = line_opacity * find_line(pixel, new_line_state);
    colour = paper + coverage * (colour - paper);
    picture = vec4(colour + line * (line_colour - colour), max(coverage, line));
}
