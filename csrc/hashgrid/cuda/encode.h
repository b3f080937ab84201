// The hash grid (hashgrid/hashgrid.h) on a GPU. Calls are asynchronous, as in points/cuda/render.h. Arrays are in GPU
// memory, but query.levels is in host memory.
#pragma once

#include "hashgrid/hashgrid.h"

namespace fourd::hashgrid::cuda {

void encode(const Query& query, float* out, void* stream);

// The order of sums over points is not fixed, so the last bits can differ between calls.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::hashgrid::cuda
