// The point renderer on a GPU. Callers check shapes and sizes; every pointer is to GPU memory, dense and row-major.
// Nothing here waits for the GPU: work is queued on a stream.
#pragma once

#include <cstddef>
#include <cstdint>

#include "points/points.h"

namespace fourd::points::cuda {

// Scratch memory with space for a number of (point, tile) entries. If a picture needs more, every pixel visits
// every point: the same picture, slowly. The GPU reports the number needed for later pictures, since reading it before
// allocating would stall.
struct EntryBuffer {
    void* memory;           // workspace_bytes of it
    std::size_t entries;    // below 2^31
    std::uint64_t* needed;  // written by the GPU: page-locked host memory, or GPU memory
};

constexpr int kMaxLayersBackward = 64;

// For a picture, its gradient or its visibility.
std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries);

// Ignores settings.threads and settings.simd.
void render(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Image& out, void* stream);

// Three channels, as rounded bytes over a background.
void draw(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Canvas& out, void* stream);

// settings.layers is at most kMaxLayersBackward; transmittance_min is ignored. The order of sums over a point's
// pixels is not fixed: the last bits of gradients differ between runs.
void render_backward(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer,
                     const ImageGradient& gradient, const CloudGradient& out, void* stream);

// out (count,): each point's largest weight in any pixel. cloud.features is not read.
void visibility(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, float* out, void* stream);

}  // namespace fourd::points::cuda
