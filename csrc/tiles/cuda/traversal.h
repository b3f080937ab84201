// Front-to-back traversal of the primitives of a tile. Each pixel has one thread. A warp covers 8 x 4 pixels and
// processes the same primitive for all its pixels at the same time.
#pragma once

#include "tiles/cuda/entries.h"

namespace fourd::tiles::cuda {

struct Pixel {
    float x, y;         // Coordinates of the centre of the pixel.
    bool inside;        // Whether the pixel is inside the image.
    std::size_t index;  // Index in the image, row by row, valid only if the pixel is inside.
    std::size_t tile;
};

// Finds the pixel of the thread with this index. Threads are numbered tile by tile. Each pixel of a tile has a thread,
// even if the pixel is outside the image.
FOURD_DEVICE static inline Pixel pixel_of(std::size_t index, const Tiles& tiles, int width, int height) {
    constexpr int kAcross = 8, kDown = device::kWarpSize / kAcross;
    const std::size_t tile = index / kTilePixels;
    const int warp = static_cast<int>(index % kTilePixels) / device::kWarpSize;
    const int lane = static_cast<int>(index % device::kWarpSize);
    const int column = static_cast<int>(tile % tiles.columns) * kTile + warp % 2 * kAcross + lane % kAcross;
    const int row = static_cast<int>(tile / tiles.columns) * kTile + warp / 2 * kDown + lane / kAcross;
    return {pixel_centre(column), pixel_centre(row), column < width && row < height,
            static_cast<std::size_t>(row) * width + column, tile};
}

// The primitives that the pixels of a tile process, nearest first. The list contains the entries of the tile, or all
// visible primitives if the entries do not fit into the workspace.
struct EntryList {
    // Ranks (positions in depth order) of the primitives. If `ranks` is null, the primitive at position i has rank i.
    const std::uint32_t* ranks;
    std::size_t count;

    FOURD_DEVICE std::size_t rank(std::size_t position) const { return ranks ? ranks[position] : position; }
};

template <typename Splat>
FOURD_DEVICE static inline EntryList entry_list(const Entries<Splat>& entries, std::size_t tile) {
    if (entries.begin[entries.count] > entries.capacity) return {nullptr, *entries.visible};
    const std::uint32_t begin = entries.tile_begin[tile];
    return {entries.entry_ranks + begin, entries.tile_begin[tile + 1] - begin};
}

// Composites the primitives of a list front to back. Each primitive that hits the pixel is a layer. A pixel is complete
// if it has `layers` layers or a transmittance of at most transmittance_min. The traversal ends when all pixels of the
// warp are complete or outside the image. The compositor provides pixel_coverage(splat, x, y), whose result has an
// `alpha` above 0 if the primitive hits the pixel. This function calls take(position, rank, splat, coverage,
// transmittance) for every layer, where `position` is the index in the list and `transmittance` is the transmittance in
// front of the layer. Returns the final transmittance.
template <typename Splat, typename Take>
FOURD_DEVICE static inline float traverse(const Entries<Splat>& entries, const EntryList& list, const Pixel& pixel, int layers,
                                          float transmittance_min, const device::Lane& lane, const Take& take) {
    float transmittance = 1.0f;
    int layers_left = pixel.inside ? layers : 0;
    for (std::size_t position = 0; position < list.count; ++position) {
        const bool open = layers_left > 0 && transmittance > transmittance_min;
        if (!lane.any(open)) break;
        const std::size_t rank = list.rank(position);
        const Splat& splat = entries.splats[rank];
        const auto coverage = pixel_coverage(splat, pixel.x, pixel.y);
        if (!open || !(coverage.alpha > 0.0f)) continue;
        take(position, rank, splat, coverage, transmittance);
        transmittance = transmittance * (1.0f - coverage.alpha);
        --layers_left;
    }
    return transmittance;
}

}  // namespace fourd::tiles::cuda
