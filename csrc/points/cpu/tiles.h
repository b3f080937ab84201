// The inner loops over points and over single tiles, compiled once for each instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"
#include "points/points.h"

namespace fourd::points {

constexpr int kBlocks = 16;  // blocks of a tile, row by row; each is one Lanes (lanes.h)

// A sort item: the bits of the depth, which sort like the depth since it is positive, and the point.
struct Item {
    std::uint32_t key;
    std::uint32_t point;
};

struct Tile {
    const Splat* splats;           // by point
    const float* features;         // by point, channels each
    const std::uint32_t* entries;  // the tile's points, nearest first; ties in the order of their indices
    std::size_t count;             // of entries
    int channels;
    int layers;
    float transmittance_min;
    int column, row;    // of its first pixel
    int width, height;  // of the image
};

// Scratch memory of the backward pass: the forward pass's visits of entries to blocks, in the order of entries, then
// blocks.
struct Visits {
    float* transmittance;  // 16 per visit: before the entry; negative for pixels that it does not hit
    std::uint64_t* tags;   // 16 * entry + block, or kNoVisit if no pixel was hit
    std::size_t count;     // count_visits of the tile
};

constexpr std::uint64_t kNoVisit = ~std::uint64_t{0};

struct Loops {
    // Projects points begin to end into splats and tile_ranges, by point, and lists the visible ones in items; returns
    // their number.
    std::size_t (*project)(const Cloud& cloud, const Settings& settings, std::size_t begin, std::size_t end,
                           Splat* splats, TileRange* tile_ranges, Item* items);

    void (*render)(const Tile& tile, const Image& out);

    // Three channels over a background, as bytes.
    void (*draw)(const Tile& tile, const Canvas& out);

    // sums: by slot, one SplatGradient and the gradient of the features (5 + channels floats).
    void (*render_backward)(const Tile& tile, const ImageGradient& gradient, const Visits& visits,
                            const std::size_t* slots, float* sums);

    // weights: by slot, initially 0.
    void (*visibility)(const Tile& tile, const std::size_t* slots, float* weights);
};

FOURD_DISPATCH(Loops, Simd::avx512)

// The number of (entry, block) pairs of a tile, hit or not.
std::size_t count_visits(const Tile& tile);

}  // namespace fourd::points
