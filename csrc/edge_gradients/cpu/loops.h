// Loops over the rows of an image, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "edge_gradients/pairs.h"

namespace fourd::edge_gradients {

// One term of the gradient of one vertex. The term comes from one pair of neighbouring pixels: a visibility edge
// (edge_gradients.h) passes between the centres of the two pixels, and moves if the vertex moves.
struct Contribution {
    std::uint32_t vertex;  // Index over all instances: instance * vertices + vertex.
    float x, y, z, w;
};

struct Loops {
    // Writes to `codes`, for each pixel of the given rows, a code that describes the visibility edges between the pixel
    // and its right and lower neighbours (see find_edge in pairs.h). Returns the number of contributions that
    // `contribute` writes for these rows. `scratch` has three floats for each pixel of a row.
    std::size_t (*find)(const Plan&, const Rows&, const float* gradient, float* scratch, std::uint8_t* codes);

    void (*contribute)(const Plan&, const Rows&, const float* gradient, const std::uint8_t* codes, Contribution* out);

    // Overwrites `positions` at the vertices [begin, end) with the sums of their contributions, added in the order of
    // the array.
    void (*scatter)(const Contribution*, std::size_t count, std::size_t begin, std::size_t end, float* positions);
};

// The loops are not compiled for AVX-512: memory accesses and branches limit their speed, so wider vectors would not
// help.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::edge_gradients
