// Texture lookup (texture/texture.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All arrays
// are in GPU memory.
#pragma once

#include "texture/texture.h"

namespace fourd::texture::cuda {

void sample(const Query& query, float* out, void* stream);

// The backward pass of sample(), with the arguments of fourd::texture::sample_backward (texture/texture.h). The order
// of the additions over pixels is not fixed, so the last bits of the gradients of levels can differ between calls.
void sample_backward(const Query& query, const float* gradient, bool is_chain, const Gradients& out, void* stream);

void build_mips(const Shape& shape, const float* base, float* const* mips, void* stream);

}  // namespace fourd::texture::cuda
