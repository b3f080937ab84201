// K-Planes (planes/planes.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All arrays are in
// GPU memory, except query.planes and the array of pointers grad_planes, which are in host memory.
#pragma once

#include "planes/planes.h"

namespace fourd::planes::cuda {

constexpr int kMaxPlanes = 64;  // Limits the size of the kernel arguments, which contain all planes.

void sample(const Query& query, float* out, void* stream);

// The order of the additions over points is not fixed, so the last bits of the gradients can differ between calls.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::planes::cuda
