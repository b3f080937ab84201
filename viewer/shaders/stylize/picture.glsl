// Draws a closed surface in a style. lines.glsl and shading.glsl must precede this text, which is also valid GLSL ES 3.00.

uniform sampler2D albedo;
uniform sampler2D line_state;  // Strength of the lines of the previous image from the same camera.
uniform float line_opacity;
uniform vec3 line_colour;
uniform float hysteresis;
uniform vec3 paper;

layout(location = 0) out vec4 picture;
layout(location = 1) out float line_strength;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 own = texelFetch(albedo, pixel, 0), packed_normal = texelFetch(closed_normal, pixel, 0);
    vec3 normal = packed_normal.w > 0.0 ? unpack_normal(packed_normal).xyz : vec3(0.0);
    vec3 captured = clamp(own.rgb / max(own.a, 1.0 / 255.0), 0.0, 1.0);
    vec3 colour = shade(pixel, captured, normal, texelFetch(closed_depth, pixel, 0).r);
    bool had_line = texelFetch(line_state, pixel, 0).r > 127.5 / 255.0;
    line_strength = find_line(pixel, had_line ? 1.0 - hysteresis : 1.0);
    float coverage = own.a > 0.0 ? packed_normal.w : 0.0, line = line_opacity * line_strength;
    colour = paper + coverage * (colour - paper);
    picture = vec4(colour + line * (line_colour - colour), max(coverage, line));
}
