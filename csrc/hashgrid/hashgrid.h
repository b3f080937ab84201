// Encodes points by a multi-resolution hash grid. Callers check shapes; every pointer is to a dense row-major array.
#pragma once

#include <cstddef>

#include "common/simd.h"
#include "hashgrid/maths.h"

namespace fourd::hashgrid {

constexpr int kMaxFeatures = 8;

struct Query {
    const float* table;        // (entries, features)
    std::size_t entries;       // of all levels, with padding
    const Level* levels;       // in the order of the table
    int level_count;           // 1 to kMaxLevels
    int features;              // 1 to kMaxFeatures
    const float* coordinates;  // (count, 3), x, y and z; clamped to [0, 1]
    std::size_t count;
    int threads;  // at least 1; the result does not depend on it
    Simd simd;    // one that this machine runs
};

// out (count, level_count * features): the levels concatenated.
void encode(const Query& query, float* out);

// gradient (count, level_count * features). Overwrites grad_table (entries, features) and grad_coordinates (count, 3);
// either may be null.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates);

}  // namespace fourd::hashgrid
