// Points of space encoded by a multi-resolution hash grid. Callers check shapes; every pointer is to a dense
// row-major array.
#pragma once

#include <cstddef>

#include "common/simd.h"
#include "hashgrid/maths.h"

namespace fourd::hashgrid {

constexpr int kMostFeatures = 8;

struct Query {
    const float* table;        // (entries, features)
    std::size_t entries;       // up to the last level's last
    const Level* levels;       // one after another in the table
    int level_count;           // 1 to kMostLevels
    int features;              // 1 to kMostFeatures
    const float* coordinates;  // (count, 3), x, y and z in [0, 1]; clamped to that
    std::size_t count;
    int threads;  // at least 1; the result does not depend on it
    Simd simd;    // one that this machine runs
};

// out (count, level_count * features): the levels side by side.
void encode(const Query& query, float* out);

// gradient (count, level_count * features). grad_table (entries, features) and grad_coordinates (count, 3), each null
// where it is not wanted; all is written.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates);

}  // namespace fourd::hashgrid
