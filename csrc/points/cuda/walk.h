// A pixel's way through its tile's points. One thread a pixel; a warp holds 8 x 4 of them, and looks at the same
// point at the same time.
#pragma once

#include "points/cuda/entries.h"

namespace fourd::points::cuda {

struct Pixel {
    float x, y;         // of its centre
    bool inside;        // the image
    std::size_t place;  // in the image, row by row; only where inside
    std::size_t tile;
};

// index counts the pixels of whole tiles, tile by tile.
FOURD_DEVICE static inline Pixel pixel_of(std::size_t index, const Tiles& tiles, int width, int height) {
    constexpr int kAcross = 8, kDown = device::kWarp / kAcross;
    const std::size_t tile = index / kTilePixels;
    const int warp = static_cast<int>(index % kTilePixels) / device::kWarp;
    const int lane = static_cast<int>(index % device::kWarp);
    const int column = static_cast<int>(tile % tiles.columns) * kTile + warp % 2 * kAcross + lane % kAcross;
    const int row = static_cast<int>(tile / tiles.columns) * kTile + warp / 2 * kDown + lane / kAcross;
    return {pixel_centre(column), pixel_centre(row), column < width && row < height,
            static_cast<std::size_t>(row) * width + column, tile};
}

// What a tile's pixels look at, nearest first: its entries, or every visible point where there was no room.
struct Row {
    const std::uint32_t* ranks;  // null: rank i is i
    std::size_t count;

    FOURD_DEVICE std::size_t rank(std::size_t place) const { return ranks ? ranks[place] : place; }
};

FOURD_DEVICE static inline Row row_of(const Entries& entries, std::size_t tile) {
    if (entries.begin[entries.count] > entries.room) return {nullptr, *entries.visible};
    const std::uint32_t begin = entries.tile_begin[tile];
    return {entries.entry_ranks + begin, entries.tile_begin[tile + 1] - begin};
}

// Goes through a row, front to back, until no pixel of the warp takes more; take(place, rank, splat, touch,
// transmittance) is called for what the pixel composites. Returns the light that is left.
template <typename Take>
FOURD_DEVICE static inline float walk(const Entries& entries, const Row& row, const Pixel& pixel, int layers,
                                  float transmittance_min, const device::Lane& lane, const Take& take) {
    float transmittance = 1.0f;
    int left = pixel.inside ? layers : 0;
    for (std::size_t place = 0; place < row.count; ++place) {
        const bool open = left > 0 && transmittance > transmittance_min;
        if (!lane.any(open)) break;
        const std::size_t rank = row.rank(place);
        const Splat& splat = entries.splats[rank];
        const PixelTouch at = touch_pixel(splat, pixel.x, pixel.y);
        if (!open || !(at.alpha > 0.0f)) continue;
        take(place, rank, splat, at, transmittance);
        transmittance = transmittance * (1.0f - at.alpha);
        --left;
    }
    return transmittance;
}

}  // namespace fourd::points::cuda
