// out = a * x + y. All arrays must be dense, and the caller must check their sizes.
#pragma once

#include <cstddef>

#include "common/dispatch.h"

namespace fourd::saxpy {

struct Loops {
    void (*saxpy)(float a, const float* x, const float* y, std::size_t count, float* out);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::saxpy
