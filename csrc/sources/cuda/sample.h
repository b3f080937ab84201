// Sampling of source views on a GPU, asynchronous as points/cuda/render.h. Arrays are in GPU memory; query.cameras is
// in host memory.
#pragma once

#include "sources/sources.h"

namespace fourd::sources::cuda {

constexpr int kMaxViews = 16;  // cameras are passed by value as a kernel's argument

void sample(const Query& query, const Samples& out, void* stream);

// gradient: with respect to Samples' channels; visibility has none. The order of sums is not fixed.
void sample_backward(const Query& query, const float* gradient, const Gradients& out, void* stream);

}  // namespace fourd::sources::cuda
