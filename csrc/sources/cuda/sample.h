// Sampling of source views on a GPU. As points/cuda/render.h: arrays are in the GPU's memory, and nothing waits.
// query.cameras is in the host's.
#pragma once

#include "sources/sources.h"

namespace fourd::sources::cuda {

constexpr int kMostViews = 16;  // cameras travel as a kernel's argument

void sample(const Query& query, const Samples& out, void* stream);

// gradient: as Samples' channels; trust has none. Sums are made in no set order.
void sample_backward(const Query& query, const float* gradient, const Gradients& out, void* stream);

}  // namespace fourd::sources::cuda
