// The inner loops over points and over single tiles, compiled once for each instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"
#include "points/points.h"

namespace fourd::points {

constexpr int kBlocks = 16;  // blocks per tile, row by row; the pixels of a block form one Lanes (lanes.h)

// A sort item: a point and the bits of its depth. Depths are positive, so their bits have the same order as the depths.
struct Item {
    std::uint32_t key;
    std::uint32_t point;
};

struct Tile {
    const Splat* splats;           // indexed by point
    const float* features;         // by point, with `channels` floats each
    const std::uint32_t* entries;  // the tile's points, nearest first; points of equal depth by index
    std::size_t count;             // number of entries
    int channels;
    int layers;
    float transmittance_min;
    int column, row;    // of the first pixel of the tile
    int width, height;  // of the image
};

// Scratch memory of the backward pass. A visit is one (entry, block) pair in which the point of the entry may hit
// pixels of the block. Visits are sorted by entry, then by block.
struct Visits {
    float* transmittance;  // per visit and pixel of the block: transmittance before the entry; negative if not hit
    std::uint64_t* tags;   // 16 * entry + block, or kNoVisit if no pixel was hit
    std::size_t count;     // count_visits(tile)
};

constexpr std::uint64_t kNoVisit = ~std::uint64_t{0};

struct Loops {
    // Projects points [begin, end) into splats and tile_ranges, which are indexed by point, and lists the visible
    // points in items. Returns the number of visible points.
    std::size_t (*project)(const Cloud& cloud, const Settings& settings, std::size_t begin, std::size_t end,
                           Splat* splats, TileRange* tile_ranges, Item* items);

    void (*render)(const Tile& tile, const Image& out);

    // Renders three channels over a background, as bytes.
    void (*draw)(const Tile& tile, const Canvas& out);

    // sums has 5 + channels floats per slot: one SplatGradient and the gradient of the features.
    void (*render_backward)(const Tile& tile, const ImageGradient& gradient, const Visits& visits,
                            const std::size_t* slots, float* sums);

    // weights has one float per slot, initially 0.
    void (*visibility)(const Tile& tile, const std::size_t* slots, float* weights);
};

FOURD_DISPATCH(Loops, Simd::avx512)

// The number of visits of a tile, including visits that hit no pixel.
std::size_t count_visits(const Tile& tile);

}  // namespace fourd::points
