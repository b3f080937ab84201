// What is done to runs of points and to single tiles: compiled once for each instruction set, chosen when
// the program runs.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"
#include "points/points.h"

namespace fourd::points {

constexpr int kBlocks = 16;  // of a tile, row by row; one vector of lanes.h each

// What is sorted: the depth's bits, which order like the depth since it is positive, and the point.
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

// Where the backward pass remembers what it met on its way forward: the visits of entries to blocks, entry by
// entry and block by block.
struct Visits {
    float* transmittance;  // 16 a visit: before the entry, negative where the pixel was not hit
    std::uint64_t* tags;   // 16 * entry + block, or kNoVisit where no pixel was hit
    std::size_t count;     // count_visits of the tile
};

constexpr std::uint64_t kNoVisit = ~std::uint64_t{0};

struct Loops {
    // Projects points begin to end into splats and reaches, by point, and lists the visible ones; returns how many.
    std::size_t (*project)(const Cloud& cloud, const Settings& settings, std::size_t begin, std::size_t end,
                           Splat* splats, Reach* reaches, Item* items);

    void (*render)(const Tile& tile, const Image& out);

    // Three channels over a background, as bytes.
    void (*draw)(const Tile& tile, const Canvas& out);

    // sums: by slot, one SplatGradient and the features' gradient (5 + channels floats).
    void (*render_backward)(const Tile& tile, const ImageGradient& gradient, const Visits& visits,
                            const std::size_t* slots, float* sums);

    // weights: by slot, zero before.
    void (*visibility)(const Tile& tile, const std::size_t* slots, float* weights);
};

FOURD_DISPATCH(Loops, Simd::avx512)

// How often the tile's entries meet its blocks, hit or not.
std::size_t count_visits(const Tile& tile);

}  // namespace fourd::points
