// Triangle splatting (splat_triangles/splat_triangles.h) on a GPU. Functions queue work on a stream and do not wait for
// the GPU. All arrays are in GPU memory.
#pragma once

#include <cstddef>

#include "splat_triangles/splat_triangles.h"
#include "tiles/cuda/entry_buffer.h"

namespace fourd::splat_triangles::cuda {

using tiles::cuda::EntryBuffer;

// Returns the size in bytes of the workspace for render or render_backward. `count` is the number of triangles, and
// `entries` is the number of (triangle, tile) pairs for which the workspace has space.
std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries);

// Renders the triangles. For each triangle, also writes its largest compositing weight over all pixels to `weight`
// (count,). The function ignores settings.threads and settings.simd.
void render(const Mesh& mesh, const Settings& settings, const EntryBuffer& buffer, const Image& out, float* weight,
            void* stream);

// The order of the additions over pixels and over triangles is not fixed, so the last bits of gradients can differ
// between calls.
void render_backward(const Mesh& mesh, const Settings& settings, const EntryBuffer& buffer,
                     const ImageGradient& gradient, const MeshGradient& out, void* stream);

}  // namespace fourd::splat_triangles::cuda
