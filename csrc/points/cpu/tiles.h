// What is done to one tile: compiled once for each instruction set, chosen when the program runs.
#pragma once

#include <cstddef>
#include <cstdint>

#include "points/points.h"

namespace fourd::points {

struct Tile {
    const Splat* splats;           // by point
    const float* features;         // by point, channels each
    const std::uint32_t* entries;  // the tile's points, nearest first
    std::size_t count;             // of entries
    int channels;
    int layers;
    float transmittance_min;
    int column, row;    // of its first pixel
    int width, height;  // of the image
};

// Where the backward pass remembers what it met on its way forward, one visit (an entry in a row of
// the tile that hits a pixel) after the other; room for the tile's every entry in its every row.
struct Visits {
    float* transmittance;  // 16 a visit: before the entry, negative where the pixel was not hit
    std::uint64_t* tags;   // 16 * entry + row
};

struct TileKernels {
    void (*render)(const Tile& tile, const Image& out);

    // sums: by slot, one SplatGradient and the features' gradient (5 + channels floats), zero before.
    void (*render_backward)(const Tile& tile, const ImageGradient& gradient, const Visits& visits,
                            const std::size_t* slots, float* sums);

    // weights: by slot, zero before.
    void (*visibility)(const Tile& tile, const std::size_t* slots, float* weights);
};

extern const TileKernels tile_kernels_baseline;
#ifdef FOURD_X86
extern const TileKernels tile_kernels_avx2;
extern const TileKernels tile_kernels_avx512;
#endif

// The kernels for a Settings::simd; throws std::invalid_argument if this machine cannot run them.
const TileKernels& tile_kernels(const char* simd);

}  // namespace fourd::points
