// Soft rasterization of triangles on the CPU. Callers check shapes and vertex indices. Every pointer points to a dense
// row-major array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"
#include "soft_triangles/maths.h"

namespace fourd::soft_triangles {

constexpr int kMaxChannels = 32;

struct Mesh {
    const float* xyz;         // Shape (vertices, 3).
    const std::int32_t* tri;  // Shape (count, 3): vertex indices.
    const float* features;    // Shape (count, channels).
    std::size_t vertices;     // Below 2^31.
    std::size_t count;        // Below 2^31.
    int channels;             // From 1 to kMaxChannels.
};

struct Settings {
    tiles::Pinhole camera;
    Softness softness;
    float near_depth;  // Positive. Triangles with a vertex at a camera depth below near_depth are culled.
    int layers;        // Largest number of triangles per pixel, from 1 to 2^20.
    int threads;       // At least 1. The result is the same for any number of threads.
    Simd simd;         // An instruction set that this machine supports.
};

struct Image {
    float* features;  // Shape (height, width, channels).
    float* alpha;     // Shape (height, width).
};

struct ImageGradient {
    const float* features;
    const float* alpha;
};

struct MeshGradient {
    float* xyz;
    float* features;
};

struct Workspace;  // Reusable memory. This type is defined in cpu/workspace.h.

void render(const Mesh& mesh, const Settings& settings, Workspace& workspace, const Image& out);

void render_backward(const Mesh& mesh, const Settings& settings, Workspace& workspace, const ImageGradient& gradient,
                     const MeshGradient& out);

}  // namespace fourd::soft_triangles
