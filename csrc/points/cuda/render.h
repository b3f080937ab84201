// The point renderer on a GPU. Callers check shapes and sizes. Every pointer points to a dense row-major array in GPU
// memory. Calls are asynchronous: they queue work on a stream and do not wait for the GPU.
#pragma once

#include <cstddef>
#include <cstdint>

#include "points/points.h"

namespace fourd::points::cuda {

// Scratch memory with space for a number of (point, tile) entries. If an image needs more entries, every pixel goes
// through every point, which gives the same image but is slow. The GPU writes the needed number to `needed`, which
// helps to choose the number of entries for later images. Waiting for the number of the same image would stall the CPU.
struct EntryBuffer {
    void* memory;           // workspace_bytes() bytes
    std::size_t entries;    // below 2^31
    std::uint64_t* needed;  // written by the GPU: page-locked host memory, or GPU memory
};

constexpr int kMaxLayersBackward = 64;

// Bytes of workspace for render, draw, render_backward or visibility.
std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries);

// Ignores settings.threads and settings.simd.
void render(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Image& out, void* stream);

// Renders three channels over a background, as rounded bytes.
void draw(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Canvas& out, void* stream);

// settings.layers is at most kMaxLayersBackward; transmittance_min is ignored. The order of sums over the pixels of a
// point is not fixed, so the last bits of gradients can differ between calls.
void render_backward(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer,
                     const ImageGradient& gradient, const CloudGradient& out, void* stream);

// out (count,) is the largest weight of each point in any pixel. cloud.features is not read.
void visibility(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, float* out, void* stream);

}  // namespace fourd::points::cuda
