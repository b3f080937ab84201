// The point renderer (points/points.h) on a GPU. Callers check shapes and sizes. Every pointer points to a dense
// row-major array in GPU memory. Functions queue work on a stream and do not wait for the GPU.
#pragma once

#include <cstddef>
#include <cstdint>

#include "points/points.h"
#include "tiles/cuda/entry_buffer.h"

namespace fourd::points::cuda {

using tiles::cuda::EntryBuffer;

constexpr int kMaxLayersBackward = 64;

// Returns the size in bytes of the workspace for render, draw, render_backward or visibility. `entries` is the number of
// (point, tile) pairs for which the workspace has space.
std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries);

// Renders a cloud. The function ignores settings.threads and settings.simd.
void render(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Image& out, void* stream);

// Renders three channels over a background, to an 8-bit image with rounded values.
void draw(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Canvas& out, void* stream);

// Computes the gradient of render(). settings.layers must be at most kMaxLayersBackward. settings.transmittance_min is
// ignored. The order of the additions over the pixels of a point is not fixed, so the last bits of gradients can differ
// between calls.
void render_backward(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer,
                     const ImageGradient& gradient, const CloudGradient& out, void* stream);

// For each point, writes its largest weight (transmittance * alpha) over all pixels to `out` (count,). cloud.features
// is not read.
void visibility(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, float* out, void* stream);

}  // namespace fourd::points::cuda
