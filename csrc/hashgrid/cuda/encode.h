// The hash grid (hashgrid/hashgrid.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All
// arrays are in GPU memory, except query.levels, which is in host memory.
#pragma once

#include "hashgrid/hashgrid.h"

namespace fourd::hashgrid::cuda {

void encode(const Query& query, float* out, void* stream);

// The order of the additions over points is not fixed, so the last bits of the gradients can differ between calls.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::hashgrid::cuda
