// The hash grid on a GPU (hashgrid/hashgrid.h), asynchronous as points/cuda/render.h. Arrays are in GPU memory;
// query.levels is in host memory.
#pragma once

#include "hashgrid/hashgrid.h"

namespace fourd::hashgrid::cuda {

void encode(const Query& query, float* out, void* stream);

// The order of sums over points is not fixed: the last bits differ between runs.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::hashgrid::cuda
