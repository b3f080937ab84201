// The interpolation (interpolate/interpolate.h) on a GPU. Functions queue work on a stream and do not wait for the GPU.
// All arrays are in GPU memory.
#pragma once

#include "interpolate/interpolate.h"

namespace fourd::interpolate::cuda {

void interpolate(const Query& query, float* out, float* out_da, void* stream);

// The order of the additions over pixels is not fixed, so the last bits of the gradient of attr can differ between
// calls.
void interpolate_backward(const Query& query, const Gradients& gradients, void* stream);

}  // namespace fourd::interpolate::cuda
