// Projects points, sorts them by depth and bins them into tiles, on a GPU.
#pragma once

#include <cstring>

#include "device/arena.h"
#include "device/executor.h"
#include "points/cuda/render.h"

namespace fourd::points::cuda {

constexpr int kTilePixels = kTile * kTile;
constexpr std::uint32_t kCulled = 0xffffffffu;  // Sort key of culled points, above the key of any depth.

struct Tiles {
    int columns, rows;

    FOURD_HD std::size_t count() const { return static_cast<std::size_t>(columns) * rows; }
};

inline Tiles make_tiles(int width, int height) { return {(width + kTile - 1) / kTile, (height + kTile - 1) / kTile}; }

// The arrays of the workspace of an image. The rank of a point is its position in depth order. Points of equal depth
// are ranked by index, and culled points come last. An entry is one (point, tile) pair.
struct Entries {
    std::size_t count;     // Number of points.
    std::size_t capacity;  // Maximum number of entries.
    Tiles tiles;
    Splat* by_point;
    Splat* splats;               // Indexed by rank.
    std::uint32_t* keys;         // Sort keys: first the depths of points, then the tiles of entries.
    std::uint32_t* values;       // Sort values: first points, then the ranks of entries.
    std::uint32_t* depths;       // Bits of the depth, indexed by rank.
    std::uint32_t* points;       // Indexed by rank.
    std::uint64_t* tile_counts;  // Number of tiles of each rank, followed by a 0.
    std::uint64_t* begin;        // First entry of each rank, followed by the number of entries.
    std::uint32_t* entry_tiles;  // Tile of each entry, in ascending order.
    std::uint32_t* entry_ranks;  // Rank of each entry, sorted by tile, then by rank.
    std::uint32_t* tile_begin;   // First entry of each tile, followed by the number of entries.
    std::uint32_t* visible;      // Number of visible points.
    float* sums;                 // Sums of gradients over pixels, indexed by rank.
    void* scratch;
    std::size_t scratch_bytes;
};

// Allocates the arrays. `sums` is the number of floats that Entries::sums has per point.
inline Entries allocate_entries(device::Arena& arena, std::size_t count, int sums, Tiles tiles, std::size_t capacity) {
    Entries out{};
    const std::size_t sorted = count > capacity ? count : capacity;
    out.count = count;
    out.capacity = capacity;
    out.tiles = tiles;
    out.by_point = arena.take<Splat>(count);
    out.splats = arena.take<Splat>(count);
    out.keys = arena.take<std::uint32_t>(sorted);
    out.values = arena.take<std::uint32_t>(sorted);
    out.depths = arena.take<std::uint32_t>(count);
    out.points = arena.take<std::uint32_t>(count);
    out.tile_counts = arena.take<std::uint64_t>(count + 1);
    out.begin = arena.take<std::uint64_t>(count + 1);
    out.entry_tiles = arena.take<std::uint32_t>(capacity);
    out.entry_ranks = arena.take<std::uint32_t>(capacity);
    out.tile_begin = arena.take<std::uint32_t>(tiles.count() + 1);
    out.visible = arena.take<std::uint32_t>(1);
    out.sums = arena.take<float>(count * static_cast<std::size_t>(sums));
    out.scratch_bytes = device::Executor::scratch_bytes(sorted + 1);
    out.scratch = arena.take<unsigned char>(out.scratch_bytes);
    return out;
}

// The index of the first element that is not below value, in an ascending array.
template <typename T>
FOURD_DEVICE static inline std::size_t lower_bound(const T* sorted, std::size_t count, T value) {
    std::size_t first = 0;
    while (count > 0) {
        const std::size_t half = count / 2;
        if (sorted[first + half] < value) {
            first += half + 1;
            count -= half + 1;
        } else {
            count = half;
        }
    }
    return first;
}

struct ProjectPoint {
    Cloud cloud;
    Pinhole camera;
    float near_depth;
    Entries to;

    FOURD_DEVICE void operator()(std::size_t point) const {
        const Projection at =
            project(camera, near_depth, cloud.xyz + 3 * point, cloud.radius[point], cloud.density[point]);
        std::uint32_t key = kCulled;
        if (at.visible) memcpy(&key, &at.z, sizeof key);
        to.by_point[point] = at.visible ? splat_of(at) : Splat{};
        to.keys[point] = key;
        to.values[point] = static_cast<std::uint32_t>(point);
    }
};

// This kernel is called for ranks 0 to `count`, inclusive. Rank `count` is not a point: the exclusive sum at this rank
// is the number of entries.
struct GatherRank {
    Entries to;

    FOURD_DEVICE void operator()(std::size_t rank) const {
        if (rank == to.count) {
            to.tile_counts[rank] = 0;
            *to.visible = static_cast<std::uint32_t>(lower_bound(to.depths, to.count, kCulled));
            return;
        }
        const Splat splat = to.by_point[to.points[rank]];
        to.splats[rank] = splat;
        to.tile_counts[rank] = to.depths[rank] == kCulled ? 0 : tile_count(tile_range_of(splat));
    }
};

// This kernel has one thread per entry, not per point, because the number of tiles of a point ranges from one to all
// tiles.
struct EmitEntry {
    Entries to;

    FOURD_DEVICE void operator()(std::size_t entry) const {
        std::uint32_t tile = static_cast<std::uint32_t>(to.tiles.count());  // This key sorts after all tiles.
        std::uint32_t rank = 0;
        if (entry < to.begin[to.count]) {
            // The rank of an entry is the last rank whose first entry is at or before this entry. A rank without tiles
            // has the same first entry as the next rank, so this search never finds a rank without tiles.
            rank = static_cast<std::uint32_t>(lower_bound(to.begin, to.count + 1, std::uint64_t{entry} + 1) - 1);
            const TileRange range = tile_range_of(to.splats[rank]);
            const std::uint64_t place = entry - to.begin[rank];
            const std::uint64_t across = tiles_across(range);
            const int row = range.top + static_cast<int>(place / across);
            const int column = range.left + static_cast<int>(place % across);
            tile = static_cast<std::uint32_t>(row) * to.tiles.columns + column;
        }
        to.keys[entry] = tile;
        to.values[entry] = rank;
    }
};

struct FindTileBegin {
    Entries to;
    std::uint64_t* needed;

    FOURD_DEVICE void operator()(std::size_t tile) const {
        to.tile_begin[tile] =
            static_cast<std::uint32_t>(lower_bound(to.entry_tiles, to.capacity, static_cast<std::uint32_t>(tile)));
        if (tile == 0) *needed = to.begin[to.count];
    }
};

inline int bit_count(std::size_t max) {
    int bits = 0;
    while (max >> bits != 0) ++bits;
    return bits;
}

// Builds the entries of a cloud, and allocates `sums` floats per point.
inline Entries fill(const device::Executor& executor, const Cloud& cloud, const Settings& settings,
                    const EntryBuffer& buffer, int sums) {
    device::Arena arena(buffer.memory);
    const Tiles tiles = make_tiles(settings.camera.width, settings.camera.height);
    const Entries to = allocate_entries(arena, cloud.count, sums, tiles, buffer.entries);
    executor.for_each(cloud.count, ProjectPoint{cloud, settings.camera, settings.near_depth, to});
    executor.sort(to.keys, to.depths, to.values, to.points, cloud.count, 32, to.scratch, to.scratch_bytes);
    executor.for_each(cloud.count + 1, GatherRank{to});
    executor.exclusive_sum(to.tile_counts, to.begin, cloud.count + 1, to.scratch, to.scratch_bytes);
    executor.for_each(buffer.entries, EmitEntry{to});
    executor.sort(to.keys, to.entry_tiles, to.values, to.entry_ranks, buffer.entries, bit_count(tiles.count()),
                  to.scratch, to.scratch_bytes);
    executor.for_each(tiles.count() + 1, FindTileBegin{to, buffer.needed});
    return to;
}

}  // namespace fourd::points::cuda
