// The inner loops over pixels, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "interpolate/interpolate.h"

namespace fourd::interpolate {

constexpr int kTile = 32;  // Side of a tile in pixels.

struct GradientTile {
    const float* attr;            // Shape (vertices, channels): attributes for the image.
    // Shape (slots,): triangle of each slot. A slot is the index of a triangle among the triangles that are visible in
    // the tile.
    const std::int32_t* visible;
    const std::int16_t* slot_of;  // Shape (kTile, kTile): slot of each pixel, or -1 at pixels without a triangle.
    int column, row;              // Position of the first pixel of the tile.
    std::size_t first;            // Index of the image's first pixel.
    float* sums;                  // Shape (slots, 3, channels), initially 0, or null if attr needs no gradient.
};

struct Loops {
    // Writes the outputs at the pixels [begin, end). All of them belong to one image, whose attributes are `attr`, but
    // `begin` and `end` are indices among the pixels of all images.
    void (*forward)(const Query& query, const float* attr, std::size_t begin, std::size_t end, float* out,
                    float* out_da);

    void (*backward)(const Query& query, const GradientTile& tile, const Gradients& gradients);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::interpolate
