// K-Planes: interpolates feature planes at points in space and time. Callers check shapes. Every pointer points to a
// dense row-major array.
#pragma once

#include <cstddef>

#include "common/simd.h"
#include "planes/maths.h"

namespace fourd::planes {

constexpr int kMaxFeatures = 64;

struct Query {
    const Plane* planes;
    int plane_count;
    int features;              // Number of features of every plane, from 1 to kMaxFeatures.
    const float* coordinates;  // Shape (count, 4): x, y, z and t of each point, clamped to [-1, 1].
    std::size_t count;         // Below 2^32.
    int threads;               // At least 1. The result is the same for any number of threads.
    Simd simd;                 // An instruction set that this machine supports.
};

// Writes to `out` (count, plane_count * features) the concatenated features of all planes.
void sample(const Query& query, float* out);

// Computes the gradients of sample(). `gradient` (count, plane_count * features) is the gradient of the loss with
// respect to the output of sample(). The function overwrites grad_coordinates (count, 4), which may be null, and the
// arrays grad_planes[k], each of which has the shape of the values of plane k.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates);

}  // namespace fourd::planes
