// The inner loops over single tiles, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "rasterize/maths.h"
#include "rasterize/rasterize.h"

namespace fourd::rasterize {

constexpr int kTile = 32;  // Side of a tile in pixels.
constexpr int kTilePixels = kTile * kTile;

// The plane equations (Planes in maths.h) of the triangles in one tile, as a structure of arrays. There are `capacity`
// elements per array.
struct Records {
    static constexpr int kFields = 3 * kPlanes + 4;
    // Shape (kFields, capacity): the members c, x, y, low and high of Planes, the triangle id encoded as a float
    // (common/triangle_id.h), and Planes::scale.
    float* values;
    std::uint32_t* references;  // Reference pixels (see Planes): x in the lower 16 bits, y in the upper 16 bits.
    std::size_t capacity;

    float* c(int plane) const { return values + plane * capacity; }
    float* x(int plane) const { return values + (kPlanes + plane) * capacity; }
    float* y(int plane) const { return values + (2 * kPlanes + plane) * capacity; }
    float* low() const { return values + 3 * kPlanes * capacity; }
    float* high() const { return values + (3 * kPlanes + 1) * capacity; }
    float* id() const { return values + (3 * kPlanes + 2) * capacity; }
    float* scale() const { return values + (3 * kPlanes + 3) * capacity; }
};

struct Tile {
    Screen screen;
    const float* pos;         // Shape (vertices, 4): positions for the image.
    const std::int32_t* tri;  // Shape (triangles, 3).
    const Piece* pieces;      // Pieces of the tile, in ascending order of triangle indices.
    std::size_t count;        // Number of pieces.
    int column, row;          // Image column and row of the tile's first pixel.
    Records records;          // Scratch memory for at least `count` records.
    const float* previous;    // Shape (height, width, 4): `rast` of the previous layer, or null.
    float* rast;              // Shape (height, width, 4).
    float* rast_db;           // Shape (height, width, 4), or null.
};

// The arguments of the backward pass of one tile. A slot is the index of a triangle among the triangles that are
// visible in the tile.
struct GradientTile {
    Screen screen;
    const float* pos;              // Shape (vertices, 4): positions for the image.
    std::size_t vertices;          // Number of vertices.
    const std::int32_t* tri;       // Shape (triangles, 3).
    const std::int32_t* visible;   // Shape (slots,): triangle of each slot.
    int slots;                     // Number of slots, at most kTilePixels.
    const std::int16_t* slot_of;   // Shape (kTile, kTile): slot of each pixel, or -1 at pixels without a triangle.
    int column, row;               // Image column and row of the tile's first pixel.
    Records records;               // Scratch memory for at least `slots` records.
    float* sums;                   // Scratch memory for at least (slots, kSumStride) floats.
    const float* grad_rast;        // Shape (height, width, 4).
    const float* grad_db;          // Shape (height, width, 4), or null.
    float* out;                    // Shape (slots, 12): gradients of x, y, z and w of the three vertices.
};

constexpr std::size_t kSumStride = 16;  // Number of floats per slot in GradientTile::sums, a multiple of the vector size.

struct Loops {
    // Rasterizes the pieces of a tile (whole triangles or parts of clipped triangles), and writes all pixels of the
    // tile.
    void (*rasterize)(const Tile& tile);

    // Computes the gradients with respect to the vertices of all triangles that are visible in the tile.
    void (*backward)(const GradientTile& tile);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::rasterize
