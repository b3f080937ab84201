export const OUTLINES = /* glsl */ `
// Draws lines over a shaded image, except for specks (very short lines), as remove_specks in
// fourd/rendering/ops/stylize/reference.py does.

uniform sampler2D shaded;
uniform highp usampler2D lines;  // The state of the lines, in the layout of csrc/stylize/stylize.h.
uniform int thickness;
uniform float line_opacity;
uniform vec3 line_colour;

out vec4 picture;

// Minimum strength, from 0 to 255, of the lines that reaches_square() takes into account. It ignores weaker lines.
const uint LEAST_STRENGTH = 32u;

// Returns the strength, from 0 to 255, of the line at a pixel. There are no lines outside the image.
uint strength_at(ivec2 pixel) {
    bool is_outside = any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, textureSize(lines, 0)));
    return is_outside ? 0u : texelFetch(lines, pixel, 0).r & 255u;
}

// Returns true if a line of at least LEAST_STRENGTH crosses the border of a square around a pixel. The border is
// reach pixels away from this pixel.
bool reaches_square(ivec2 pixel, int reach) {
    for (int along = -reach; along <= reach; ++along) {
        uint rows = max(strength_at(pixel + ivec2(along, -reach)), strength_at(pixel + ivec2(along, reach)));
        uint columns = max(strength_at(pixel + ivec2(-reach, along)), strength_at(pixel + ivec2(reach, along)));
        if (max(rows, columns) >= LEAST_STRENGTH) return true;
    }
    return false;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    uint own = strength_at(pixel);
    bool is_drawn = own > 0u;
    for (int reach = 1; is_drawn && reach <= 4 * (thickness + 1); reach *= 2) is_drawn = reaches_square(pixel, reach);
    float line = is_drawn ? line_opacity * float(own) / 255.0 : 0.0;
    picture = texelFetch(shaded, pixel, 0);
    picture = vec4(mix(picture.rgb, line_colour, line), max(picture.a, line));
}
`;
