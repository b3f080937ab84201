export const PIXEL_FILTER = /* glsl */ `
// The pixel filter, which is a weighted mean of 3 x 3 values. POSITION is the type of positions, vec2 or ivec2.

uniform float pixel_filter;  // Weight of each neighbour in the 3-tap filters along rows and columns; 0 for none.

// Returns the value at a position. The shader that contains this code defines it.
vec4 tap(POSITION position);

vec4 filter_taps(vec4 middle, vec4 sides) { return pixel_filter * sides + (1.0 - 2.0 * pixel_filter) * middle; }

vec4 filter_row(POSITION position, POSITION right) {
    return filter_taps(tap(position), tap(position - right) + tap(position + right));
}

// Returns the filtered value. The arguments right and down are steps of one pixel.
vec4 filtered(POSITION position, POSITION right, POSITION down) {
    if (pixel_filter == 0.0) return tap(position);
    vec4 sides = filter_row(position - down, right) + filter_row(position + down, right);
    return filter_taps(filter_row(position, right), sides);
}
`;
