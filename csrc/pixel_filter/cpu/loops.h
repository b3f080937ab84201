// The inner loop over the pixels of a row, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "pixel_filter/pixel_filter.h"

namespace fourd::pixel_filter {

constexpr int kChannels = 4;

// A row of pixels, with the rows above and below it.
struct Rows {
    const std::uint8_t *above, *centre, *below;
};

struct Loops {
    // Writes the pixels [begin, end) of the filtered row to the same places of `out`. A row has `width` pixels, of which
    // the function reads only those from begin - 1 to end.
    void (*row)(const Rows& rows, int width, int begin, int end, float side, std::uint8_t* out);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::pixel_filter
