// The hash grid on a GPU; see hashgrid/hashgrid.h. As points/cuda/render.h: the arrays are in the GPU's memory, and
// nothing waits. query.levels is in the host's.
#pragma once

#include "hashgrid/hashgrid.h"

namespace fourd::hashgrid::cuda {

void encode(const Query& query, float* out, void* stream);

// Sums over points are made in no set order: the last bits differ from run to run.
void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates,
                     void* stream);

}  // namespace fourd::hashgrid::cuda
