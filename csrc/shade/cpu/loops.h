// The inner loops of shading, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "shade/shade.h"

namespace fourd::shade {

constexpr int kBlock = 64;  // points per batch; their intermediate values stay in the L1 cache

struct Loops {
    // Computes the colours of points [begin, end). out is indexed by point.
    void (*shade)(const Points& points, std::size_t begin, std::size_t end, const Settings& settings, float* out);
};

// The 16 harmonics and 4 views of a point fill AVX2 vectors, so there are no loops for AVX-512.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::shade
