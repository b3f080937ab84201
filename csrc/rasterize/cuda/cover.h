// Two kernels that find the nearest triangle of each pixel. A piece is a whole triangle or a part of a clipped
// triangle. In the first kernel, one warp per triangle tests the pixels of the triangle's small pieces, and adds
// triangles with large pieces to a list. In the second kernel, one warp per tile tests the pixels of the tile against
// the large pieces of all listed triangles, so that no warp has to process a whole image.
#pragma once

#include "rasterize/cuda/triangles.h"

namespace fourd::rasterize::cuda {

constexpr int kTile = 32;             // Side of a tile in pixels. A warp covers one row at a time.
constexpr int kSmallPixels = 32 * 32;  // A piece is small if its bounding box has at most this number of pixels.

FOURD_DEVICE static inline bool is_small(const Bounds& bounds) {
    return (bounds.right - bounds.left + 1) * (bounds.bottom - bounds.top + 1) <= kSmallPixels;
}

// The triangles of all images. An item is one triangle of one image. Every image has longest_range items, where
// longest_range is the largest number of triangles that any image has. If an image has fewer triangles, its last items
// have no triangle.
struct Items {
    Query query;
    std::size_t longest_range;
    std::uint64_t* listed;  // Items with a large piece, in any order.
    std::uint32_t* count;   // Number of listed items.

    FOURD_DEVICE std::size_t image_of(std::uint64_t item) const { return item / longest_range; }

    // Loads the triangle of an item. Returns false if the item has no triangle, or if one of the triangle's vertex
    // indices is out of range.
    FOURD_DEVICE bool load(const Screen& screen, std::uint64_t item, Triangle* out) const {
        const std::size_t image = image_of(item);
        std::size_t first = 0, count_of_image = query.triangles;
        if (query.ranges != nullptr) {
            const std::int32_t from = query.ranges[2 * image], size = query.ranges[2 * image + 1];
            if (from < 0 || size < 0) return false;
            first = static_cast<std::size_t>(from);
            count_of_image = static_cast<std::size_t>(size);
        }
        const std::size_t offset = item % longest_range;
        if (offset >= count_of_image || first + offset >= query.triangles) return false;
        return load_triangle(query, screen, image, first + offset, out);
    }
};

struct CoverSmall {
    Items items;
    Target target;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const std::uint64_t item = index / device::kWarpSize;
        const int number = static_cast<int>(index % device::kWarpSize);
        Triangle triangle;
        if (!items.load(target.screen, item, &triangle)) return;
        bool has_large = false;
        for_pieces_of(target.screen, triangle, [&](const Piece& piece, const Bounds& bounds) {
            if (!is_small(bounds)) {
                has_large = true;
                return;
            }
            const Planes planes = planes_of(target.screen, triangle, piece.reference_x, piece.reference_y);
            if (!planes.is_valid) return;
            const int columns = bounds.right - bounds.left + 1, rows = bounds.bottom - bounds.top + 1;
            for (int i = number; i < columns * rows; i += device::kWarpSize) {
                target.test(piece, planes, items.image_of(item), bounds.left + i % columns, bounds.top + i / columns);
            }
        });
        if (has_large && lane.is_first()) items.listed[device::atomic_increment(items.count)] = item;
    }
};

struct CoverLarge {
    Items items;
    Target target;
    int columns;              // Number of tiles per row.
    std::size_t tiles;        // Number of tiles per image.

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane&) const {
        const std::size_t warp = index / device::kWarpSize, image = warp / tiles, tile = warp % tiles;
        const int left = static_cast<int>(tile % columns) * kTile, top = static_cast<int>(tile / columns) * kTile;
        const int column = left + static_cast<int>(index % device::kWarpSize);
        for (std::uint32_t i = 0; i < *items.count; ++i) {
            Triangle triangle;
            if (items.image_of(items.listed[i]) != image) continue;
            if (!items.load(target.screen, items.listed[i], &triangle)) continue;
            for_pieces_of(target.screen, triangle, [&](const Piece& piece, const Bounds& bounds) {
                if (is_small(bounds)) return;
                const int first = larger(bounds.top, top), last = smaller(bounds.bottom, top + kTile - 1);
                if (first > last || bounds.right < left || bounds.left >= left + kTile) return;
                for (int k = 0; k < 3; ++k) {
                    if (largest_value(edge_of(piece, k, left, top), kTile, kTile) < 0) return;
                }
                const Planes planes = planes_of(target.screen, triangle, piece.reference_x, piece.reference_y);
                if (!planes.is_valid || column < bounds.left || column > bounds.right) return;
                for (int row = first; row <= last; ++row) target.test(piece, planes, image, column, row);
            });
        }
    }
};

}  // namespace fourd::rasterize::cuda
