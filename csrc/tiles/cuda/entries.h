// Sorts primitives by depth and bins them into tiles, on a GPU. A compositor provides the type Splat of its projected
// primitives, the function tile_range_of(splat), and a kernel that projects the primitives.
#pragma once

#include <cstring>

#include "device/arena.h"
#include "device/executor.h"
#include "tiles/cuda/entry_buffer.h"
#include "tiles/geometry.h"

namespace fourd::tiles::cuda {

constexpr int kTilePixels = kTile * kTile;
constexpr std::uint32_t kCulled = 0xffffffffu;  // Sort key of culled primitives, above the key of any depth.

struct Tiles {
    int columns, rows;

    FOURD_HD std::size_t count() const { return static_cast<std::size_t>(columns) * rows; }
};

inline Tiles make_tiles(int width, int height) { return {(width + kTile - 1) / kTile, (height + kTile - 1) / kTile}; }

// The arrays of the workspace of an image. The rank of a primitive is its position in depth order. Primitives of equal
// depth are ranked by index, and culled primitives come last. An entry is one (primitive, tile) pair.
template <typename Splat>
struct Entries {
    std::size_t count;     // Number of primitives.
    std::size_t capacity;  // Maximum number of entries.
    Tiles tiles;
    Splat* by_index;             // Indexed by primitive.
    Splat* splats;               // Indexed by rank.
    // The keys and values of two sorts. The first sort puts the primitives into depth order. Its keys are the depths of
    // the primitives, and its values are their indices. The second sort puts the entries into the order of tiles. Its
    // keys are the tiles of the entries, and its values are the ranks of their primitives.
    std::uint32_t* keys;
    std::uint32_t* values;
    std::uint32_t* depths;       // Bits of the depth of each primitive, indexed by rank.
    std::uint32_t* indices;      // Index of the primitive of each rank.
    std::uint64_t* tile_counts;  // Number of tiles that the primitive of each rank covers. The last element is 0.
    // For each rank, the index of the first entry of its primitive in a list of all entries that is ordered by rank (the
    // input of the second sort). The last element is the count of all entries.
    std::uint64_t* begin;
    std::uint32_t* entry_tiles;  // Tile of each entry, in ascending order.
    std::uint32_t* entry_ranks;  // Rank of each entry's primitive. Entries are sorted by tile, then by rank.
    // For each tile, the index of its first entry in entry_tiles. The last element is the count of all entries.
    std::uint32_t* tile_begin;
    std::uint32_t* visible;      // Number of visible primitives.
    float* sums;                 // Sums of gradients over pixels, indexed by rank.
    void* scratch;
    std::size_t scratch_bytes;
};

// Allocates the arrays. `sums` is the number of floats that Entries::sums has per primitive.
template <typename Splat>
Entries<Splat> allocate_entries(device::Arena& arena, std::size_t count, int sums, Tiles tiles, std::size_t capacity) {
    Entries<Splat> out{};
    const std::size_t sorted = count > capacity ? count : capacity;
    out.count = count;
    out.capacity = capacity;
    out.tiles = tiles;
    out.by_index = arena.take<Splat>(count);
    out.splats = arena.take<Splat>(count);
    out.keys = arena.take<std::uint32_t>(sorted);
    out.values = arena.take<std::uint32_t>(sorted);
    out.depths = arena.take<std::uint32_t>(count);
    out.indices = arena.take<std::uint32_t>(count);
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

// Returns the index of the first element that is at least `value`, in an ascending array.
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

// Copies the splats into depth order and fills tile_counts. The kernel is also called for the rank `count`, which has
// no primitive, to set the last element of tile_counts to 0. The exclusive prefix sum of tile_counts is the array
// `begin`, so the last element of `begin` is the count of all entries.
template <typename Splat>
struct GatherRank {
    Entries<Splat> to;

    FOURD_DEVICE void operator()(std::size_t rank) const {
        if (rank == to.count) {
            to.tile_counts[rank] = 0;
            *to.visible = static_cast<std::uint32_t>(lower_bound(to.depths, to.count, kCulled));
            return;
        }
        const Splat splat = to.by_index[to.indices[rank]];
        to.splats[rank] = splat;
        to.tile_counts[rank] = to.depths[rank] == kCulled ? 0 : tile_count(tile_range_of(splat));
    }
};

// Writes the sort key (tile) and the sort value (rank) of an entry. The kernel has one thread per entry, because
// threads per primitive would have very unequal work: one primitive may cover a single tile, and another all tiles.
template <typename Splat>
struct EmitEntry {
    Entries<Splat> to;

    FOURD_DEVICE void operator()(std::size_t entry) const {
        // Unused entries get a key above the key of every tile.
        std::uint32_t tile = static_cast<std::uint32_t>(to.tiles.count());
        std::uint32_t rank = 0;
        if (entry < to.begin[to.count]) {
            // The primitive of this entry has the last rank with begin[rank] <= entry. A rank without tiles has the
            // same `begin` as the next rank, so this search never finds a rank without tiles.
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

template <typename Splat>
struct FindTileBegin {
    Entries<Splat> to;
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

// Returns the size in bytes of the workspace of an image.
template <typename Splat>
std::size_t entry_bytes(std::size_t count, int sums, int width, int height, std::size_t entries) {
    device::Arena arena(nullptr);
    allocate_entries<Splat>(arena, count, sums, make_tiles(width, height), entries);
    return arena.bytes();
}

// Builds the entries of `count` primitives, and allocates Entries::sums with `sums` floats per primitive.
// project_into(entries) returns a kernel that is called with the index i of each primitive. The kernel writes
// by_index[i], keys[i] and values[i]. The key is kCulled for a culled primitive, and the bits of the depth for all
// others. The value is i.
template <typename Splat, typename ProjectInto>
Entries<Splat> fill(const device::Executor& executor, std::size_t count, int width, int height,
                    const EntryBuffer& buffer, int sums, const ProjectInto& project_into) {
    device::Arena arena(buffer.memory);
    const Tiles tiles = make_tiles(width, height);
    const Entries<Splat> to = allocate_entries<Splat>(arena, count, sums, tiles, buffer.entries);
    executor.for_each(count, project_into(to));
    executor.sort(to.keys, to.depths, to.values, to.indices, count, 32, to.scratch, to.scratch_bytes);
    executor.for_each(count + 1, GatherRank<Splat>{to});
    executor.exclusive_sum(to.tile_counts, to.begin, count + 1, to.scratch, to.scratch_bytes);
    executor.for_each(buffer.entries, EmitEntry<Splat>{to});
    executor.sort(to.keys, to.entry_tiles, to.values, to.entry_ranks, buffer.entries, bit_count(tiles.count()),
                  to.scratch, to.scratch_bytes);
    executor.for_each(tiles.count() + 1, FindTileBegin<Splat>{to, buffer.needed});
    return to;
}

}  // namespace fourd::tiles::cuda
