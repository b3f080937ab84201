// The image encoder (encoder/encoder.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All
// arrays are in GPU memory, except the arrays of pointers.
#pragma once

#include <cstddef>

#include "encoder/encoder.h"

namespace fourd::encoder::cuda {

// Numbers of floats for all images: of the maps that forward() writes and backward() reads, and of backward()'s
// workspace.
std::size_t saved_size(const Sizes& sizes);
std::size_t workspace_size(const Sizes& sizes);

void forward(const Sizes& sizes, const float* const* weights, const float* images, float* features, float* saved,
             void* stream);

// The order of the additions over pixels is not fixed, so the last bits of the gradients can differ between calls.
void backward(const Sizes& sizes, const float* const* weights, const float* saved, const float* grad_features,
              float* workspace, float* const* out, void* stream);

}  // namespace fourd::encoder::cuda
