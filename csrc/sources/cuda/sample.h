// Samples source views on a GPU. Calls are asynchronous, as in points/cuda/render.h. Arrays are in GPU memory, but
// query.cameras is in host memory.
#pragma once

#include "sources/sources.h"

namespace fourd::sources::cuda {

constexpr int kMaxViews = 16;  // cameras are passed to the kernel by value

void sample(const Query& query, const Samples& out, void* stream);

// `gradient` is the gradient with respect to Samples::channels. The visibility is treated as constant. The order of
// sums is not fixed.
void sample_backward(const Query& query, const float* gradient, const Gradients& out, void* stream);

}  // namespace fourd::sources::cuda
