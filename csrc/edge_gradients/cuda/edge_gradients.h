// Gradients of visibility edges (edge_gradients/edge_gradients.h) on a GPU. Functions queue work on a stream and do not
// wait for the GPU. All arrays are in GPU memory. The order in which gradients are summed is not fixed, so their last
// bits can differ between calls.
#pragma once

#include "antialias/antialias.h"

namespace fourd::edge_gradients::cuda {

// Returns the size in bytes of the `workspace` that edge_gradients() needs.
std::size_t workspace_bytes(const antialias::Mesh& mesh, std::size_t images);

void edge_gradients(const antialias::Mesh& mesh, const antialias::Images& images, void* workspace,
                    const float* gradient, float* positions, void* stream);

}  // namespace fourd::edge_gradients::cuda
