// Code that all compositors share: cameras, and the tiles and blocks of an image.
//
// All functions are static, because they are compiled once per instruction set (common/dispatch.h), and the linker
// would otherwise keep only one of the compiled copies.
#pragma once

#include <cstdint>

#include "common/host_device.h"

namespace fourd::tiles {

// A pinhole camera: x_camera = rotation * x_world + translation; pixels = intrinsics * x_camera / z, where z is the
// third coordinate of x_camera.
struct Pinhole {
    float intrinsics[9];
    float rotation[9];
    float translation[3];
    int width;
    int height;
};

constexpr int kTile = 16;              // Side of a tile in pixels.
constexpr int kBlock = 4;              // Side of a block in pixels. A tile has 4 x 4 blocks.
constexpr int kLongestSide = 1 << 18;  // Largest image side in pixels, so that block indices fit into 16 bits.
constexpr int kBlocks = 16;            // Blocks per tile, row by row. A block has one pixel per lane (lanes.h).

// The range of tiles that a primitive covers. All bounds are inclusive. The range is empty if right < left.
struct TileRange {
    std::uint16_t left, right, top, bottom;
};

FOURD_HD static inline std::uint64_t tiles_across(const TileRange& range) {
    return static_cast<std::uint64_t>(range.right - range.left + 1);
}

FOURD_HD static inline std::uint64_t tile_count(const TileRange& range) {
    return tiles_across(range) * static_cast<std::uint64_t>(range.bottom - range.top + 1);
}

// An item of the depth sort: the index of a primitive, and the bits of its depth as the sort key. Depths are positive,
// so the order of their bits is the order of the depths.
struct Item {
    std::uint32_t key;
    std::uint32_t index;
};

// Returns the coordinate of a pixel's centre. The conversion is exact, because float32 represents every pixel index
// exactly.
FOURD_HD static inline float pixel_centre(int index) { return static_cast<float>(index) + 0.5f; }

}  // namespace fourd::tiles
