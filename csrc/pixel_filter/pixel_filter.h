// The pixel filter: each pixel of an 8-bit image becomes a weighted mean of 3 x 3 pixels. The weights along an axis are
// `side`, 1 - 2 * side and `side`. Beyond the border of the image, the nearest pixel is repeated. Callers check shapes,
// and arrays are dense and row-major.
#pragma once

#include <cstdint>

#include "common/buffer.h"
#include "common/simd.h"
#include "common/team.h"

namespace fourd::pixel_filter {

struct Image {
    const std::uint8_t* rgba;  // Shape (height, width, 4).
    int width, height;
};

// Writes the filtered image to `out` (height, width, 4), which must not overlap image.rgba. `side` is in [0, 0.25].
void filter_pixels(const Image& image, float side, int threads, Simd simd, std::uint8_t* out);

// A rectangle of pixels: the pixels with left <= column < right and top <= row < bottom.
struct Region {
    int left, top, right, bottom;
};

// Replaces the pixels of a region of the image `rgba` (height, width, 4) by those of the filtered image. Pixels outside
// the region are read but stay unchanged. `scratch` is memory that callers keep for the next image.
void filter_in_place(std::uint8_t* rgba, int width, int height, const Region& region, float side, Simd simd, Team& team,
                     Buffer<std::uint8_t>& scratch);

}  // namespace fourd::pixel_filter
