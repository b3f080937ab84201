// The inner loops over the points of one level, compiled once for each instruction set and number of features.
#pragma once

#include "common/dispatch.h"
#include "hashgrid/hashgrid.h"

namespace fourd::hashgrid {

struct LevelLoops {
    void (*encode)(const Query&, int level, std::size_t begin, std::size_t end, float* out);
    void (*scatter)(const Query&, int level, const float* gradient, float* grad_table);
    void (*coordinate_gradient)(const Query&, int level, std::size_t begin, std::size_t end, const float* gradient,
                                float* grad_coordinates);
};

struct Loops {
    LevelLoops by_features[kMaxFeatures];

    const LevelLoops& of(int features) const { return by_features[features - 1]; }
};

// Because memory bandwidth limits the speed of these loops, AVX-512 would be only 5% faster than AVX2, which does not
// justify the additional code.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::hashgrid
