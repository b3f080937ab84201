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
    int features;              // features of every plane, 1 to kMaxFeatures
    const float* coordinates;  // (count, 4), x, y, z and t; clamped to [-1, 1]
    std::size_t count;         // below 2^32
    int threads;               // at least 1; does not change the result
    Simd simd;                 // an instruction set that this machine supports
};

// out (count, plane_count * features) is the concatenation of the planes' features.
void sample(const Query& query, float* out);

// gradient (count, plane_count * features). Overwrites grad_planes, which has one array per plane with the shape of the
// plane's values. Also overwrites grad_coordinates (count, 4) unless it is null.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates);

}  // namespace fourd::planes
