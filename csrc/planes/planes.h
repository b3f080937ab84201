// K-Planes: points of space and time looked up in feature planes. Callers check shapes; every
// pointer is to a dense row-major array.
#pragma once

#include <cstddef>

#include "common/simd.h"
#include "planes/maths.h"

namespace fourd::planes {

constexpr int kMostFeatures = 64;

struct Query {
    const Plane* planes;
    int plane_count;
    int features;              // of every plane, 1 to kMostFeatures
    const float* coordinates;  // (count, 4), x, y, z and t in [-1, 1]; clamped to that
    std::size_t count;         // below 2^32
    int threads;               // at least 1; the result does not depend on it
    Simd simd;                 // one that this machine runs
};

// out (count, plane_count * features): the planes side by side.
void sample(const Query& query, float* out);

// gradient (count, plane_count * features). grad_planes has a pointer for each plane, to an array like
// its values; all is written. grad_coordinates (count, 4) or null where it is not wanted.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates);

}  // namespace fourd::planes
