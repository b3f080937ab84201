// The inner loop over rows of pixels, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "stylize/stylize.h"

namespace fourd::stylize {

struct Loops {
    void (*rows)(const Surface& surface, const Style& style, int begin, int end, std::uint32_t* line_state,
                 std::uint8_t* out);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::stylize
