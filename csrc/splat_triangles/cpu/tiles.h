// The inner loops over triangles and over single tiles, compiled once for each instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"
#include "splat_triangles/splat_triangles.h"

namespace fourd::splat_triangles {

using tiles::Item;
using tiles::kBlock;
using tiles::kBlocks;
using tiles::kTile;
using tiles::pixel_centre;
using tiles::TileRange;

struct Tile {
    const Splat* splats;           // Indexed by triangle.
    const float* features;         // Indexed by triangle, with `channels` floats per triangle.
    const std::uint32_t* entries;  // Triangles of the tile, nearest first. Triangles of equal depth are in index order.
    std::size_t count;             // Number of entries.
    int channels;
    bool geometry;
    int layers;
    int column, row;    // Position of the first pixel of the tile.
    int width, height;  // Size of the image.
};

struct Loops {
    // Projects the triangles [begin, end) into `splats` and `tile_ranges`, which are both indexed by triangle. Lists
    // the visible triangles in `items`, and returns their count.
    std::size_t (*project)(const Mesh& mesh, const Settings& settings, std::size_t begin, std::size_t end,
                           Splat* splats, TileRange* tile_ranges, Item* items);

    // Renders a tile. An entry is a triangle in the list of the tile. Each pair of a triangle and a tile has one slot,
    // an index into arrays of results. slots[i] is the slot of the tile's entry i (tiles/depth_bins.h). The largest
    // compositing weight of entry i over the pixels of the tile is written to weights[slots[i]]. `best` is scratch
    // memory of 16 floats per entry.
    void (*render)(const Tile& tile, const Image& out, float* best, const std::size_t* slots, float* weights);

    // Sums the gradients of each entry over the pixels of a tile. `slots` is the same as for render(). `sums` has
    // kShapeSums + channels floats per slot: one ShapeGradient, and then the gradient of the features.
    void (*render_backward)(const Tile& tile, const ImageGradient& gradient, const std::size_t* slots, float* sums);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::splat_triangles
