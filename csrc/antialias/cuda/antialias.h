// Antialiasing (antialias/antialias.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All
// arrays are in GPU memory. The order in which gradients of positions are summed is not fixed, so their last bits can
// differ between calls.
#pragma once

#include "antialias/antialias.h"

namespace fourd::antialias::cuda {

// Returns the size in bytes of the `workspace` that blend() needs.
std::size_t workspace_bytes(const Mesh& mesh, std::size_t images);

void blend(const Mesh& mesh, const Images& images, void* workspace, float* out, std::uint8_t* codes, void* stream);

void blend_backward(const Mesh& mesh, const Images& images, const Gradients& gradients, void* stream);

}  // namespace fourd::antialias::cuda
