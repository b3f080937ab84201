// Samples source views (sources/sources.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All
// arrays are in GPU memory, except query.cameras, which is in host memory.
#pragma once

#include "sources/sources.h"

namespace fourd::sources::cuda {

constexpr int kMaxViews = 16;  // Limits the size of the kernel arguments, which contain all cameras.

void sample(const Query& query, const Samples& out, void* stream);

// Computes the gradients of sample(). `gradient` is the gradient with respect to Samples::channels. The visibility is
// treated as constant. The order of additions is not fixed, so the last bits of gradients can differ between calls.
void sample_backward(const Query& query, const float* gradient, const Gradients& out, void* stream);

}  // namespace fourd::sources::cuda
