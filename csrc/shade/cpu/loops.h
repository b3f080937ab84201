// The inner loops of shading, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "shade/shade.h"

namespace fourd::shade {

constexpr int kBlock = 64;  // Number of points per batch. Intermediate values of a batch stay in the L1 cache.

struct Loops {
    // Computes the colours of points [begin, end). Row i of `out` is the colour of point i.
    void (*shade)(const Points& points, std::size_t begin, std::size_t end, const Settings& settings, float* out);
};

// The loops are not compiled for AVX-512, because their explicit vector code uses vectors of at most 256 bits.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::shade
