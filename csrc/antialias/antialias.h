// Antialiasing of silhouette edges in a rasterized image. Callers check shapes. Every pointer points to a dense
// row-major array. Indices of vertices and triangles that are out of range are ignored.
#pragma once

#include <cstddef>
#include <cstdint>

#include "antialias/maths.h"
#include "common/simd.h"

namespace fourd::antialias {

// The colours and the rasterization of `count` images.
struct Images {
    const float* colours;  // Shape (count, height, width, channels).
    const float* rast;     // Shape (count, height, width, 4): u, v, z/w and the id of the triangle.
    std::size_t count;
    int height, width, channels;

    FOURD_HD FOURD_INLINE std::size_t pixels() const { return static_cast<std::size_t>(height) * width; }
};

struct Settings {
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.
};

// Writes the blended colours to `out` (count, height, width, channels). Each pixel forms two pairs: one with its right
// neighbour and one with its lower neighbour. Also writes to `codes` (count, height, width), for each pixel, a Code
// (maths.h) that describes the silhouette edges crossing the pixel's two pairs.
void blend(const Mesh& mesh, const Images& images, const Settings& settings, float* out, std::uint8_t* codes);

// The arguments of the backward pass of blend(). `gradient` is the gradient of the loss with respect to the `out` of
// blend(), and `codes` is the array that blend() writes. The output arrays `colours` and `positions` may be null.
struct Gradients {
    const float* gradient;
    const std::uint8_t* codes;
    float boost;       // The gradient of the positions is multiplied by this factor.
    float* colours;    // Has the shape of Images::colours.
    float* positions;  // Has the shape of Mesh::positions.
};

void blend_backward(const Mesh& mesh, const Images& images, const Settings& settings, const Gradients& gradients);

}  // namespace fourd::antialias
