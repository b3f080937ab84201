// Encodes points by a multi-resolution hash grid. Callers check shapes. Every pointer points to a dense row-major
// array.
#pragma once

#include <cstddef>

#include "common/simd.h"
#include "hashgrid/maths.h"

namespace fourd::hashgrid {

constexpr int kMaxFeatures = 8;

struct Query {
    const float* table;        // (entries, features)
    std::size_t entries;       // entries of all levels, including padding
    const Level* levels;       // in the order of the table
    int level_count;           // 1 to kMaxLevels
    int features;              // 1 to kMaxFeatures
    const float* coordinates;  // (count, 3), x, y and z; clamped to [0, 1]
    std::size_t count;
    int threads;  // at least 1; does not change the result
    Simd simd;    // an instruction set that this machine supports
};

// out (count, level_count * features) is the concatenation of the levels' features.
void encode(const Query& query, float* out);

// gradient (count, level_count * features). Overwrites grad_table (entries, features) and grad_coordinates (count, 3).
// Either may be null.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates);

}  // namespace fourd::hashgrid
