// Ray tracing (rays/rays.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All arrays are in
// GPU memory. Trees are built on the CPU.
#pragma once

#include "rays/rays.h"

namespace fourd::rays::cuda {

void trace(const TreeView& tree, const Rays& rays, const Hits& hits, void* stream);

void occluded(const TreeView& tree, const Rays& rays, std::uint8_t* out, void* stream);

// The order of the additions over hits is not fixed, so the last bits of the gradient of xyz can differ between calls.
void trace_backward(const Mesh& mesh, const HitGradients& gradients, void* stream);

}  // namespace fourd::rays::cuda
