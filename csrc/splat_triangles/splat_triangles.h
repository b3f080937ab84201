// Triangle splatting on the CPU. Callers check shapes and vertex indices. Every pointer points to a dense row-major
// array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"
#include "splat_triangles/maths.h"

namespace fourd::splat_triangles {

constexpr int kGeometry = 4;      // Channels for geometry: the normal (3) and the depth of a triangle.
constexpr int kMaxChannels = 36;  // Maximum number of channels: 32 features plus the channels for geometry.
constexpr int kShapeSums = 11;    // Number of gradient sums per triangle: the members of ShapeGradient.

struct Mesh {
    const float* xyz;          // Shape (vertices, 3).
    const std::int32_t* tri;   // Shape (count, 3): vertex indices.
    const float* features;     // Shape (count, channels). If `geometry` is true, the last 4 are normal and depth.
    const float* opacity;      // Shape (count,).
    const float* sigma;        // Shape (count,): exponent of the falloff from the incentre to the edges.
    std::size_t vertices;      // Below 2^31.
    std::size_t count;         // Below 2^31.
    int channels;              // From 1 to kMaxChannels, including the channels for geometry.
    bool geometry;             // Whether the last kGeometry channels are geometry.
};

struct Settings {
    tiles::Pinhole camera;
    float near_depth;  // Positive. Triangles with a vertex at a camera depth below near_depth are culled.
    int layers;        // Largest number of triangles per pixel, from 1 to 2^20.
    int threads;       // At least 1. The result is the same for any number of threads.
    Simd simd;         // An instruction set that this machine supports.
};

struct Image {
    float* features;       // Shape (height, width, channels without geometry).
    float* alpha;          // Shape (height, width).
    float* transmittance;  // Shape (height, width): 1 - alpha, without the rounding error of this difference.
    float* normal;         // Shape (height, width, 3), or null if Mesh::geometry is false.
    float* depth;          // Shape (height, width), or null if Mesh::geometry is false. Where alpha is 0, depth is 0.
};

// The image of the forward pass, and the gradients with respect to this image.
struct ImageGradient {
    const float* features;
    const float* alpha;
    const float* normal;  // Null if Mesh::geometry is false.
    const float* depth;   // Null if Mesh::geometry is false.
    Image rendered;
};

struct MeshGradient {
    float* xyz;
    float* features;
    float* opacity;
    float* sigma;
};

struct Workspace;  // Reusable memory. This type is defined in cpu/workspace.h.

// Renders the triangles. For each triangle, also writes its largest compositing weight over all pixels to `weight`
// (count,).
void render(const Mesh& mesh, const Settings& settings, Workspace& workspace, const Image& out, float* weight);

void render_backward(const Mesh& mesh, const Settings& settings, Workspace& workspace, const ImageGradient& gradient,
                     const MeshGradient& out);

}  // namespace fourd::splat_triangles
