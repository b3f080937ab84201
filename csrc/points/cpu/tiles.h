// The inner loops over points and over single tiles, compiled once for each instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"
#include "points/points.h"

namespace fourd::points {

using tiles::Item;
using tiles::kBlocks;

struct Tile {
    const Splat* splats;           // Indexed by point.
    const float* features;         // Indexed by point, with `channels` floats per point.
    const std::uint32_t* entries;  // Points of the tile, nearest first. Points of equal depth are in index order.
    std::size_t count;             // Number of entries.
    int channels;
    int layers;
    float transmittance_min;
    int column, row;    // Position of the first pixel of the tile.
    int width, height;  // Size of the image.
};

// The scratch memory of the backward pass. An entry is a point in the list of the tile (Tile::entries), and a block is
// one of the 16 groups of 4 x 4 pixels of the tile. A visit is one (entry, block) pair in which the point of the entry
// may hit pixels of the block. Visits are sorted by entry, then by block.
struct Visits {
    // Shape (count, 16): for each pixel of the block, the transmittance in front of the point, or -1 if the point does
    // not hit the pixel.
    float* transmittance;
    // Shape (count,): the number 16 * entry + block of each visit, or kNoVisit if the visit hits no pixel.
    std::uint64_t* tags;
    std::size_t count;  // Equal to count_visits(tile).
};

constexpr std::uint64_t kNoVisit = ~std::uint64_t{0};

// Number of features of a point for draw_surface: its colour (3), its normal times its weight (3), its weight
// (front_weight in points/front_weight.h), and its depth times its weight. The features of a point are adjacent in
// memory, so that reading a point needs only one cache line, although the points of a tile are scattered.
constexpr int kSurfaceFeatures = 8;
constexpr std::size_t kJoinedPoints = 64;

struct Loops {
    // Projects the points [begin, end) into `splats` and `tile_ranges`, which are both indexed by point. Lists the
    // visible points in `items`, and returns how many points are visible.
    std::size_t (*project)(const Cloud& cloud, const Settings& settings, std::size_t begin, std::size_t end,
                           Splat* splats, TileRange* tile_ranges, Item* items);

    void (*render)(const Tile& tile, const Image& out);

    // Renders three channels over a background, to an 8-bit image.
    void (*draw)(const Tile& tile, const Canvas& out);

    // Computes, for each of the points [begin, end), the features that draw_surface needs. The range has at most
    // kJoinedPoints points. `xyz` (count, 3), `colours` (count, 3), `octahedral` (count, 2) and `out` (count,
    // kSurfaceFeatures) are indexed by point. The normals are decoded (points/octahedral.h) and rotated to the axes of
    // the camera.
    void (*join_normals)(const Pinhole& camera, const float* xyz, const float* colours, const std::uint8_t* octahedral,
                         std::size_t begin, std::size_t end, float* out);

    // Renders the colours, and the depths and normals of the visible surface. The features of the tile are the output
    // of join_normals.
    void (*draw_surface)(const Tile& tile, const Surface& out);

    // Computes the gradient of a tile. Each pair of a point and a tile has one row in `sums`, and the index of this row
    // is the slot of the pair (tiles/depth_bins.h). For each point tile.entries[i] of the tile, the function writes the
    // gradient with respect to this point, summed over the pixels of this tile only, to the row slots[i]. A row has
    // 5 + channels floats: one SplatGradient, and then the gradient of the features.
    void (*render_backward)(const Tile& tile, const ImageGradient& gradient, const Visits& visits,
                            const std::size_t* slots, float* sums);

    // For each entry, finds the largest weight (transmittance * alpha) over the pixels of the tile, and writes it to
    // `weights`, at the slot of the entry. The caller initialises these elements to 0.
    void (*visibility)(const Tile& tile, const std::size_t* slots, float* weights);
};

FOURD_DISPATCH(Loops, Simd::avx512)

// Returns the number of visits of a tile, including visits that hit no pixel.
std::size_t count_visits(const Tile& tile);

}  // namespace fourd::points
