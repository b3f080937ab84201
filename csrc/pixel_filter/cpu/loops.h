// The inner loop over rows of pixels, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "pixel_filter/pixel_filter.h"

namespace fourd::pixel_filter {

struct Loops {
    // Writes the rows [begin, end) of the filtered image.
    void (*rows)(const Image& image, float side, int begin, int end, std::uint8_t* out);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::pixel_filter
