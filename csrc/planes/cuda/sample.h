// K-Planes (planes/planes.h) on a GPU. Functions are asynchronous, as in points/cuda/render.h. All arrays are in GPU
// memory, except query.planes and the array of pointers grad_planes, which are in host memory.
#pragma once

#include "planes/planes.h"

namespace fourd::planes::cuda {

constexpr int kMaxPlanes = 64;  // The kernel receives the planes by value.

void sample(const Query& query, float* out, void* stream);

// Sums over points have no fixed order, so the last bits of the gradients can differ between calls.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::planes::cuda
