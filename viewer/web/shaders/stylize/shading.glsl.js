export const SHADING = /* glsl */ `
// Shades a pixel, as stylize_reference in fourd/rendering/ops/stylize/reference.py does. The uniforms have the names and units of
// the class Numbers in fourd/rendering/ops/stylize/parameters.py. lines.glsl.js must precede this
// code.

uniform vec3 light;
uniform float table_alone;
uniform float table_times_albedo;
uniform float albedo_alone;
uniform float detail_offset;
uniform float detail_per_depth;
uniform float angle_threshold;
uniform float angle_softness;
uniform float angle_strength;
uniform vec3 angle_colour;
uniform float hatch_spacing;
uniform vec2 hatch_levels;
uniform float hatch_width;
uniform vec3 hatch_colour;
uniform sampler2D table;  // The shade table, in which the tone selects the column and the detail selects the row.
// The quantity that selects the table row: 0 for the cosine between normal and viewing direction, 1 for the depth, 2
// for the distance from the focus.
uniform int detail_axis;

float unit(float value) { return clamp(value, 0.0, 1.0); }

vec3 look_up(float tone, float detail) {
    ivec2 size = textureSize(table, 0);
    int column = int(tone * float(size.x - 1) + 0.5);
    float row = detail * float(size.y - 1);
    int first = min(int(row), max(size.y - 2, 0)), second = min(first + 1, size.y - 1);
    vec3 from = texelFetch(table, ivec2(column, first), 0).rgb, to = texelFetch(table, ivec2(column, second), 0).rgb;
    return from + (row - float(first)) * (to - from);
}

float hatch_layer(float position, float level, float brightness) {
    float distance = 1.0 - abs(2.0 * fract(position / hatch_spacing) - 1.0);
    float wide = hatch_width * unit((level - brightness) / max(level, 1e-6));
    return wide > 0.0 ? unit((wide - distance) * hatch_spacing * 0.5 + 0.5) : 0.0;
}

// Returns the fraction of the pixel at position (in pixels) that hatching covers with ink.
float hatching(vec2 position, float brightness) {
    float first = hatch_layer(position.x + 0.5 * position.y, hatch_levels.x, brightness);
    return max(first, hatch_layer(16384.0 + position.x - 0.7 * position.y, hatch_levels.y, brightness));
}

// Returns the colour of a surface with the captured colour own. normal is the unit normal, or 0 where there is no
// surface. inverse_depth is in 1 / world units.
vec3 shade(ivec2 pixel, vec3 own, vec3 normal, float inverse_depth) {
    vec3 towards = ray_of(pixel);
    float facing = unit(-dot(normal, towards) / sqrt(dot(towards, towards)));
    float tone = unit(0.5 + 0.5 * dot(normal, light));
    float along = detail_offset + detail_per_depth / max(inverse_depth, 1e-20);
    float detail = detail_axis == 0 ? facing : unit(detail_axis == 1 ? along : abs(along));
    vec3 colour = look_up(tone, detail) * (table_alone + table_times_albedo * own) + albedo_alone * own;
    colour = clamp(colour, 0.0, 1.0);
    float edge = unit(0.5 + (angle_threshold - facing) / (2.0 * angle_softness));
    colour += angle_strength * edge * (angle_colour - colour);
    float brightness = sqrt(unit(dot(own, vec3(0.299, 0.587, 0.114)) * tone));
    return colour + hatching(vec2(pixel) + 0.5, brightness) * (hatch_colour - colour);
}
`;
