// Samples source views on a GPU. Functions are asynchronous, as in points/cuda/render.h. All arrays are in GPU memory,
// except query.cameras, which is in host memory.
#pragma once

#include "sources/sources.h"

namespace fourd::sources::cuda {

constexpr int kMaxViews = 16;  // The kernel receives the cameras by value.

void sample(const Query& query, const Samples& out, void* stream);

// `gradient` is the gradient with respect to Samples::channels. The visibility is treated as constant. Sums have no
// fixed order, so the last bits of gradients can differ between calls.
void sample_backward(const Query& query, const float* gradient, const Gradients& out, void* stream);

}  // namespace fourd::sources::cuda
