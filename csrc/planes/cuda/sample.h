// K-Planes on a GPU; see planes/planes.h. As points/cuda/render.h: the arrays are in the GPU's memory, and nothing
// waits. query.planes itself, and the pointers of grad_planes, are in the host's.
#pragma once

#include "planes/planes.h"

namespace fourd::planes::cuda {

constexpr int kMostPlanes = 64;  // they travel as a kernel's argument

void sample(const Query& query, float* out, void* stream);

// Sums over points are made in no set order: the last bits differ from run to run.
void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::planes::cuda
