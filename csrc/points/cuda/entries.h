// Points projected, ordered by depth and sorted into tiles, on a GPU.
#pragma once

#include <cstring>

#include "device/arena.h"
#include "device/machine.h"
#include "points/cuda/render.h"

namespace fourd::points::cuda {

constexpr int kTilePixels = kTile * kTile;
constexpr std::uint32_t kCulled = 0xffffffffu;  // orders behind every depth

struct Tiles {
    int columns, rows;

    FOURD_HD std::size_t count() const { return static_cast<std::size_t>(columns) * rows; }
};

inline Tiles tiles_of(int width, int height) { return {(width + kTile - 1) / kTile, (height + kTile - 1) / kTile}; }

// The arrays of the workspace. A point's rank is its place by depth, ties by index; culled points come last.
struct Entries {
    std::size_t count;      // of points
    std::size_t room;       // for entries
    Tiles tiles;
    Splat* by_point;
    Splat* splats;          // by rank
    std::uint32_t* keys;    // of a sort: depths by point, then tiles by entry
    std::uint32_t* values;  // of a sort: points, then ranks by entry
    std::uint32_t* depths;  // by rank: the depth's bits
    std::uint32_t* points;  // by rank
    std::uint64_t* reach;   // by rank, and 0
    std::uint64_t* begin;   // by rank: the sum of reach before; last the number of entries
    std::uint32_t* entry_tiles;  // by tile
    std::uint32_t* entry_ranks;  // by tile, in each by rank
    std::uint32_t* tile_begin;   // by tile, and the end
    std::uint32_t* visible;      // how many points are
    float* sums;                 // by rank, of gradients
    void* scratch;
    std::size_t scratch_bytes;
};

// width of sums: floats a point.
inline Entries lay_out(device::Arena& arena, std::size_t count, int sums, Tiles tiles, std::size_t room) {
    Entries out{};
    const std::size_t sorted = count > room ? count : room;
    out.count = count;
    out.room = room;
    out.tiles = tiles;
    out.by_point = arena.take<Splat>(count);
    out.splats = arena.take<Splat>(count);
    out.keys = arena.take<std::uint32_t>(sorted);
    out.values = arena.take<std::uint32_t>(sorted);
    out.depths = arena.take<std::uint32_t>(count);
    out.points = arena.take<std::uint32_t>(count);
    out.reach = arena.take<std::uint64_t>(count + 1);
    out.begin = arena.take<std::uint64_t>(count + 1);
    out.entry_tiles = arena.take<std::uint32_t>(room);
    out.entry_ranks = arena.take<std::uint32_t>(room);
    out.tile_begin = arena.take<std::uint32_t>(tiles.count() + 1);
    out.visible = arena.take<std::uint32_t>(1);
    out.sums = arena.take<float>(count * static_cast<std::size_t>(sums));
    out.scratch_bytes = device::Machine::scratch_bytes(sorted + 1);
    out.scratch = arena.take<unsigned char>(out.scratch_bytes);
    return out;
}

// Where value would stand in an ascending array.
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
    float near;
    Entries to;

    FOURD_DEVICE void operator()(std::size_t point) const {
        const Projection at = project(camera, near, cloud.xyz + 3 * point, cloud.radius[point], cloud.density[point]);
        std::uint32_t key = kCulled;
        if (at.visible) memcpy(&key, &at.z, sizeof key);
        to.by_point[point] = at.visible ? splat_of(at) : Splat{};
        to.keys[point] = key;
        to.values[point] = static_cast<std::uint32_t>(point);
    }
};

// index 0 to count: the last closes the sums.
struct RankPoint {
    Entries to;

    FOURD_DEVICE void operator()(std::size_t rank) const {
        if (rank == to.count) {
            to.reach[rank] = 0;
            *to.visible = static_cast<std::uint32_t>(lower_bound(to.depths, to.count, kCulled));
            return;
        }
        const Splat splat = to.by_point[to.points[rank]];
        to.splats[rank] = splat;
        to.reach[rank] = to.depths[rank] == kCulled ? 0 : tile_count(reach_of(splat));
    }
};

// By entry, not by point: a point may reach one tile or all of them.
struct EmitEntry {
    Entries to;

    FOURD_DEVICE void operator()(std::size_t entry) const {
        std::uint32_t tile = static_cast<std::uint32_t>(to.tiles.count());  // none: behind all
        std::uint32_t rank = 0;
        if (entry < to.begin[to.count]) {
            // The last rank that begins at or before the entry; those of no reach begin where the next does.
            rank = static_cast<std::uint32_t>(lower_bound(to.begin, to.count + 1, std::uint64_t{entry} + 1) - 1);
            const Reach reach = reach_of(to.splats[rank]);
            const std::uint64_t place = entry - to.begin[rank];
            const std::uint64_t across = tiles_across(reach);
            const int row = reach.top + static_cast<int>(place / across);
            const int column = reach.left + static_cast<int>(place % across);
            tile = static_cast<std::uint32_t>(row) * to.tiles.columns + column;
        }
        to.keys[entry] = tile;
        to.values[entry] = rank;
    }
};

struct BeginTile {
    Entries to;
    std::uint64_t* needed;

    FOURD_DEVICE void operator()(std::size_t tile) const {
        to.tile_begin[tile] =
            static_cast<std::uint32_t>(lower_bound(to.entry_tiles, to.room, static_cast<std::uint32_t>(tile)));
        if (tile == 0) *needed = to.begin[to.count];
    }
};

inline int bits_of(std::size_t largest) {
    int bits = 0;
    while (largest >> bits != 0) ++bits;
    return bits;
}

// Fills the entries of a cloud; sums has room for so many floats a point.
inline Entries fill(const device::Machine& machine, const Cloud& cloud, const Settings& settings, const Room& room,
                    int sums) {
    device::Arena arena(room.memory);
    const Tiles tiles = tiles_of(settings.camera.width, settings.camera.height);
    const Entries to = lay_out(arena, cloud.count, sums, tiles, room.entries);
    machine.each(cloud.count, ProjectPoint{cloud, settings.camera, settings.near, to});
    machine.sort(to.keys, to.depths, to.values, to.points, cloud.count, 32, to.scratch, to.scratch_bytes);
    machine.each(cloud.count + 1, RankPoint{to});
    machine.sum_before(to.reach, to.begin, cloud.count + 1, to.scratch, to.scratch_bytes);
    machine.each(room.entries, EmitEntry{to});
    machine.sort(to.keys, to.entry_tiles, to.values, to.entry_ranks, room.entries, bits_of(tiles.count()), to.scratch,
                 to.scratch_bytes);
    machine.each(tiles.count() + 1, BeginTile{to, room.needed});
    return to;
}

}  // namespace fourd::points::cuda
