// K-Planes on a GPU (planes/planes.h), asynchronous as points/cuda/render.h. Arrays are in GPU memory; query.planes
// itself and the pointers of grad_planes are in host memory.
#pragma once

#include "planes/planes.h"

namespace fourd::planes::cuda {

constexpr int kMaxPlanes = 64;  // they are passed by value as a kernel's argument

void sample(const Query& query, float* out, void* stream);

// The order of sums over points is not fixed: the last bits differ between runs.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::planes::cuda
