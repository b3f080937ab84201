// The inner loops over triangles and over single tiles, compiled once for each instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"
#include "soft_triangles/soft_triangles.h"

namespace fourd::soft_triangles {

using tiles::Item;
using tiles::kBlock;
using tiles::kBlocks;
using tiles::kTile;
using tiles::pixel_centre;
using tiles::TileRange;

struct Tile {
    const Face* faces;             // Indexed by triangle.
    const float* features;         // Indexed by triangle, with `channels` floats per triangle.
    const std::uint32_t* entries;  // Triangles of the tile, in index order.
    std::size_t count;             // Number of entries.
    Softness softness;
    int channels;
    int layers;
    int column, row;    // Position of the first pixel of the tile.
    int width, height;  // Size of the image.
};

// Scratch memory. An entry is a triangle in the list of the tile, and a block is a group of 4 x 4 pixels of the tile.
// Blocks are processed one after the other. A visit is an entry whose triangle hits at least one pixel of the current
// block. `entries`, `x` and `depth` have the visits of the current block only.
struct Visits {
    std::uint16_t* blocks;   // Shape (count,): mask of the blocks that each entry may hit.
    std::uint32_t* entries;  // Shape (count,): index of the entry of each visit.
    float* x;                // Shape (count, 16): log-odds of the coverage D (maths.h).
    // Shape (count, 16): depth of the triangle, or kNoHit at pixels that the triangle does not hit, and at pixels where
    // it is not among the nearest Tile::layers triangles.
    float* depth;
};

struct Loops {
    // Projects the triangles [begin, end) into `faces` and `tile_ranges`, which are both indexed by triangle. Lists the
    // visible triangles in `items`, and returns their count.
    std::size_t (*project)(const Mesh& mesh, const Settings& settings, std::size_t begin, std::size_t end, Face* faces,
                           TileRange* tile_ranges, Item* items);

    void (*render)(const Tile& tile, const Visits& visits, const Image& out);

    // Computes the gradient of a tile. Each pair of a triangle and a tile has one slot, a row of `sums` to which the
    // gradient of the triangle is written. slots[i] is the slot of the tile's entry i (tiles/depth_bins.h). A row has
    // kShapeSums + channels floats: one ShapeGradient, and then the gradient of the features.
    void (*render_backward)(const Tile& tile, const Visits& visits, const ImageGradient& gradient,
                            const std::size_t* slots, float* sums);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::soft_triangles
