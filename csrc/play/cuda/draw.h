// A baked frame drawn from a camera on a GPU, from float16 arrays to bytes. As points/cuda/render.h: pointers are
// to the GPU's memory, and nothing waits.
#pragma once

#include "play/frame.h"
#include "points/cuda/render.h"

namespace fourd::play::cuda {

std::size_t workspace_bytes(std::size_t count, int width, int height, std::size_t entries);

// shading.chosen is in the host's memory.
void draw(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
          const points::cuda::Room& room, const points::Canvas& canvas, void* stream);

// Colours (count, 3) alone.
void shade(const shade::Points& points, const shade::Settings& shading, float* out, void* stream);

}  // namespace fourd::play::cuda
