// K-Planes (planes/planes.h) on a GPU. Calls are asynchronous, as in points/cuda/render.h. Arrays are in GPU memory,
// but query.planes itself and the pointer array grad_planes are in host memory.
#pragma once

#include "planes/planes.h"

namespace fourd::planes::cuda {

constexpr int kMaxPlanes = 64;  // planes are passed to the kernel by value

void sample(const Query& query, float* out, void* stream);

// The order of sums over points is not fixed, so the last bits can differ between calls.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::planes::cuda
