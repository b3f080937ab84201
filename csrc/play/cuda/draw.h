// Draws a baked frame on a GPU, from float16 arrays to an 8-bit image. Functions queue work on a stream and do not wait
// for the GPU. Pointers point to GPU memory, except shading.chosen and shading.view_weights, which point to host
// memory.
#pragma once

#include "play/frame.h"
#include "points/cuda/render.h"

namespace fourd::play::cuda {

std::size_t workspace_bytes(std::size_t count, int width, int height, std::size_t entries);

// Draws a frame to `canvas`.
void draw(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
          const points::cuda::EntryBuffer& buffer, const points::Canvas& canvas, void* stream);

// Writes the colours (count, 3) of the points to `out`, without drawing them.
void shade(const shade::Points& points, const shade::Settings& shading, float* out, void* stream);

}  // namespace fourd::play::cuda
