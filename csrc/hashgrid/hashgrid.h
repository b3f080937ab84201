// Encodes points with a multi-resolution hash grid. Callers check shapes. Every pointer points to a dense row-major
// array.
#pragma once

#include <cstddef>

#include "common/simd.h"
#include "hashgrid/maths.h"

namespace fourd::hashgrid {

constexpr int kMaxFeatures = 8;

struct Query {
    const float* table;        // Shape (entries, features): one feature vector per entry.
    std::size_t entries;       // Number of entries of all levels, including padding.
    const Level* levels;       // Levels in the order of the table.
    int level_count;           // From 1 to kMaxLevels.
    int features;              // From 1 to kMaxFeatures.
    const float* coordinates;  // Shape (count, 3): x, y and z of each point, clamped to [0, 1].
    std::size_t count;
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.
};

// Writes to `out` (count, level_count * features) the concatenated features of all levels.
void encode(const Query& query, float* out);

// Computes the gradients of encode(). `gradient` (count, level_count * features) is the gradient of the loss with
// respect to the encoding. The function overwrites grad_table (entries, features) and grad_coordinates (count, 3). Each
// of these two pointers may be null.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates);

}  // namespace fourd::hashgrid
