// Turns the visible surface of an image into a cartoon or a drawing. fourd/rendering/ops/stylize/parameters.py documents the
// formulas. Callers check shapes, and arrays are dense and row-major.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"

namespace fourd::stylize {

// The shade table has the colours of a style, as in X-Toon (Barla et al. 2006). The tone, which is the cosine between
// the normal and the direction to the light, mapped to [0, 1], selects the column. The detail (enum Detail) selects the
// row.
constexpr int kTones = 256;       // Number of columns of the shade table.
constexpr int kMaxRows = 64;      // Maximum number of rows of the shade table.
constexpr int kMaxThickness = 8;  // Maximum distance, in pixels, between adjacent taps (samples) of a line filter.

// Specks, which are very short lines, are not drawn. To find them, nested squares are centred at each pixel that has a
// line. The sides of the squares are 2, 4, 8, ..., 2 * reach pixels. The line at the pixel is drawn only if each of
// these squares has a line on its border. Returns `reach`, half the side of the largest square, in pixels. It is at
// most 32.
constexpr int speck_reach(int thickness) {
    int reach = 8;
    while (2 * reach <= 4 * (thickness + 1)) reach *= 2;
    return reach;
}
// A line on the border of a square (see speck_reach) counts only if its strength, from 0 to 255, is at least this
// number.
constexpr std::uint32_t kLeastStrength = 32;

// The quantity that selects the row of the shade table: the cosine between the normal and the direction to the camera,
// the depth, or the distance from the depth in focus.
enum class Detail { facing = 0, depth = 1, focus = 2 };
enum class Lines { none = 0, sobel = 1, cross = 2 };

// The numbers of a style, in the order of StyleParameters.numbers in fourd/rendering/ops/stylize/parameters.py.
struct Numbers {
    // The ray through the pixel centre (x, y) = (column + 0.5, row + 0.5), in camera axes, is
    // (ray[0] * x + ray[1] * y + ray[2], ray[3] * x + ray[4] * y + ray[5], 1).
    float ray[6];
    float light[3];  // Unit vector towards the light, in camera axes.
    // Factors of the formula colour = table * (table_alone + table_times_albedo * albedo) + albedo_alone * albedo.
    float table_alone, table_times_albedo, albedo_alone;
    float detail_offset, detail_per_depth;
    float angle_threshold, angle_softness, angle_strength, angle_colour[3];
    float depth_threshold, normal_threshold, line_opacity, line_colour[3], hysteresis, persistence;
    float hatch_spacing, hatch_levels[2], hatch_width, hatch_colour[3];
    float paper[3];
};

struct Style {
    Numbers numbers;
    Detail detail;
    Lines lines;
    int thickness;               // Distance, in pixels, between adjacent taps of the line filter: 1 to kMaxThickness.
    const std::uint32_t* table;  // Shape (rows, kTones): red in the lowest byte, then green and blue.
    int rows;                    // From 1 to kMaxRows.
};

// The visible surface (points/points.h, Surface).
struct Surface {
    const std::uint8_t* albedo;  // Shape (height, width, 4): colour multiplied by alpha, then alpha.
    const float* inverse_depth;  // Shape (height, width): coverage / camera depth, or 0 without a surface.
    const std::uint8_t* normal;  // Shape (height, width, 4): 127 * unit normal + 128, then 255 * coverage.
    int width, height;
};

// Writes the picture to `out` (height, width, 4). `line_state` (height, width) is either null or has the lines of the
// previous image from the same camera, which the function replaces by the lines of the new image. The lowest byte of an
// element of line_state is the strength of the line, where 0 means no line. The upper 16 bits of the element are the
// upper 16 bits of a float, which is the sum of the inverse depths at the nine taps of the line filter.
void stylize(const Surface& surface, const Style& style, int threads, Simd simd, std::uint32_t* line_state,
             std::uint8_t* out);

}  // namespace fourd::stylize
