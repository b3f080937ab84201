// The point renderer for a GPU. Callers check shapes and sizes; every pointer is to the GPU's memory, dense and
// row-major. Nothing here waits for the GPU: work is put on a stream, and its results are there once the stream
// has come to them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "points/points.h"

namespace fourd::points::cuda {

// Points are sorted into tiles in room for so many entries (a point in a tile is one). Where more are needed,
// every pixel looks at every point instead: the same picture, slowly. What was needed is told, so that the
// next picture gets its room; to ask before would be to wait.
struct Room {
    void* memory;          // workspace_bytes of it
    std::size_t entries;   // below 2^31
    std::uint64_t* needed; // written by the GPU: page-locked memory of the host, or the GPU's own
};

constexpr int kMostLayersBackward = 64;

// Of a picture, its gradient or its visibility.
std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries);

// settings.threads and settings.simd have no meaning here.
void render(const Cloud& cloud, const Settings& settings, const Room& room, const Image& out, void* stream);

// Three channels, as bytes over a background; alpha and colours are rounded.
void draw(const Cloud& cloud, const Settings& settings, const Room& room, const Canvas& out, void* stream);

// settings.layers is at most kMostLayersBackward; transmittance_min is taken as 0. Sums over a point's pixels are
// made in no set order: the last bits of gradients differ from run to run.
void render_backward(const Cloud& cloud, const Settings& settings, const Room& room, const ImageGradient& gradient,
                     const CloudGradient& out, void* stream);

// out (count,): the largest weight that each point has in any pixel. cloud.features is not read.
void visibility(const Cloud& cloud, const Settings& settings, const Room& room, float* out, void* stream);

}  // namespace fourd::points::cuda
