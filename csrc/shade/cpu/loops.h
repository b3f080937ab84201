// The inner loops of shading, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "shade/shade.h"

namespace fourd::shade {

constexpr int kBlock = 64;  // points whose intermediate values stay in the L1 cache

struct Loops {
    // Colours of points begin to end; out is by point.
    void (*shade)(const Points& points, std::size_t begin, std::size_t end, const Settings& settings, float* out);
};

// AVX2 vectors fit a point's 16 harmonics and 4 views: AVX-512 has no loops of its own.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::shade
