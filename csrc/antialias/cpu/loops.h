// Loops over the triangles of a mesh and over the rows of an image, compiled once for each instruction set.
#pragma once

#include "antialias/pairs.h"
#include "common/dispatch.h"

namespace fourd::antialias {

// The contribution of one crossing (Crossing in maths.h) to the gradient of one vertex.
struct Contribution {
    std::uint32_t vertex;  // Index over all instances: instance * vertices + vertex.
    float x, y, w;
};

struct Loops {
    void (*silhouettes)(const Mesh&, std::size_t instance, std::size_t begin, std::size_t end, std::uint8_t* out);

    // Writes the blended colours of the given rows to `out`, and a Code (maths.h) for each of their pixels to `codes`.
    // `scratch` has 3 * width floats.
    void (*blend)(const Plan&, const Rows&, float* scratch, float* out, std::uint8_t* codes);

    // Counts the crossings in the pairs that the pixels of the given rows form with their right and lower neighbours.
    std::size_t (*count)(const Plan&, const Rows&, const std::uint8_t* codes);

    // Writes the gradient with respect to the colours of the given rows. If `contributions` is not null, the function
    // also writes two contributions for each crossing: one for each end of the edge.
    void (*blend_backward)(const Plan&, const Rows&, const Gradients&, Contribution* contributions);

    // Overwrites `positions`, the gradient of the positions, at the vertices [begin, end). The gradient of a vertex is
    // the sum of its contributions, which are added in the order in which they are stored.
    void (*scatter)(const Contribution*, std::size_t count, std::size_t begin, std::size_t end, float* positions);
};

// The loops are not compiled for AVX-512: memory accesses and branches limit their speed, so wider vectors would not
// help.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::antialias
