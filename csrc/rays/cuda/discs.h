// Compositing of discs along rays (rays/discs.h) on a GPU. The function queues work on a stream and does not wait for
// the GPU. All arrays are in GPU memory. Trees are built on the CPU.
#pragma once

#include "rays/discs.h"

namespace fourd::rays::cuda {

void composite_discs(const DiscTreeView& tree, const Rays& rays, const DiscPicture& picture, void* stream);

}  // namespace fourd::rays::cuda
