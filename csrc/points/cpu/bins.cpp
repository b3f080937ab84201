#include "points/cpu/bins.h"

#include <algorithm>
#include <cstring>
#include <vector>

namespace fourd::points {
namespace {

// What is sorted: the depth's bits, which order like the depth since it is positive, and the point.
struct Item {
    std::uint32_t key;
    std::uint32_t point;
};

// A run of items: each thread's part of a sorting pass. Parts are merged in order, so the
// result is the same for any number of them.
struct Run {
    std::size_t begin, end;
};

struct Range {
    int first, last;
};

Range tile_range(int first, int last) { return {first / kTile, last / kTile}; }

std::vector<Run> split(std::size_t count, int parts) {
    std::vector<Run> runs;
    for (int part = 0; part < parts; ++part) {
        runs.push_back({count * part / parts, count * (part + 1) / parts});
    }
    return runs;
}

std::uint32_t bits_of(float value) {
    std::uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

// Projects every point; the items of visible ones lie at the beginning of each returned run.
std::vector<Run> project_all(const Cloud& cloud, const Settings& settings, Team& team, Bins& bins, Item* items) {
    std::vector<Run> runs = split(cloud.count, team.size());
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        Run& run = runs[part];
        std::size_t end = run.begin;
        for (std::size_t i = run.begin; i < run.end; ++i) {
            Splat& splat = bins.splats[i];
            const bool visible = project(settings.camera, settings.near, cloud.xyz + 3 * i, cloud.radius[i],
                                         cloud.density[i], &splat);
            bins.visible[i] = visible;
            if (visible) items[end++] = {bits_of(splat.z), static_cast<std::uint32_t>(i)};
        }
        run.end = end;
    });
    return runs;
}

struct KeyRange {
    std::uint32_t low = ~0u, high = 0;
};

KeyRange key_range(const std::vector<Run>& runs, const Item* items) {
    KeyRange range;
    for (const Run& run : runs) {
        for (std::size_t i = run.begin; i < run.end; ++i) {
            range.low = std::min(range.low, items[i].key);
            range.high = std::max(range.high, items[i].key);
        }
    }
    return range;
}

// One stable pass of the radix sort, by the digit of (key - low) at shift.
void radix_pass(const std::vector<Run>& runs, const Item* from, Item* to, std::uint32_t low, int shift,
                int bits, Team& team) {
    const std::size_t digits = std::size_t{1} << bits;
    const std::uint32_t mask = static_cast<std::uint32_t>(digits - 1);
    std::vector<std::uint32_t> places(runs.size() * digits, 0);
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        std::uint32_t* counts = places.data() + part * digits;
        for (std::size_t i = runs[part].begin; i < runs[part].end; ++i) ++counts[((from[i].key - low) >> shift) & mask];
    });
    std::uint32_t total = 0;
    for (std::size_t digit = 0; digit < digits; ++digit) {
        for (std::size_t part = 0; part < runs.size(); ++part) {
            std::uint32_t& place = places[part * digits + digit];
            const std::uint32_t count = place;
            place = total;
            total += count;
        }
    }
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        std::uint32_t* place = places.data() + part * digits;
        for (std::size_t i = runs[part].begin; i < runs[part].end; ++i) {
            to[place[((from[i].key - low) >> shift) & mask]++] = from[i];
        }
    });
}

// Sorts the runs by key, stably; returns whichever of the two buffers holds the result.
const Item* sort_items(std::vector<Run> runs, std::size_t count, Item* items, Item* spare, Team& team) {
    const KeyRange range = key_range(runs, items);
    int bits = 0;
    while (count > 0 && bits < 32 && ((range.high - range.low) >> bits) != 0) ++bits;
    constexpr int kMostBits = 12;  // a histogram of 4096 counters stays in the first cache
    const int passes = std::max(1, (bits + kMostBits - 1) / kMostBits);
    const int digit = std::max(1, (bits + passes - 1) / passes);
    for (int pass = 0; pass < passes; ++pass) {
        radix_pass(runs, items, spare, range.low, pass * digit, digit, team);
        std::swap(items, spare);
        runs = split(count, team.size());
    }
    return items;
}

// Calls visit(tile) for each tile that a splat reaches.
template <typename Visit>
void for_each_tile(const Splat& splat, int columns, Visit visit) {
    const Range across = tile_range(splat.column_first, splat.column_last);
    const Range down = tile_range(splat.row_first, splat.row_last);
    for (int row = down.first; row <= down.last; ++row) {
        for (int column = across.first; column <= across.last; ++column) visit(row * columns + column);
    }
}

// Counts each part's entries by tile, then lets each part write its own after those before it.
void fill_tiles(const Item* items, std::size_t count, Team& team, Bins& bins) {
    const std::size_t tiles = static_cast<std::size_t>(bins.tiles());
    const std::vector<Run> runs = split(count, team.size());
    std::vector<std::size_t> places(runs.size() * tiles, 0);
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        std::size_t* counts = places.data() + part * tiles;
        for (std::size_t i = runs[part].begin; i < runs[part].end; ++i) {
            for_each_tile(bins.splats[items[i].point], bins.columns, [&](int tile) { ++counts[tile]; });
        }
    });
    std::size_t total = 0;
    for (std::size_t tile = 0; tile < tiles; ++tile) {
        bins.tile_begin[tile] = total;
        for (std::size_t part = 0; part < runs.size(); ++part) {
            std::size_t& place = places[part * tiles + tile];
            const std::size_t here = place;
            place = total;
            total += here;
        }
    }
    bins.tile_begin[tiles] = total;
    bins.entries = Buffer<std::uint32_t>(total);
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        std::size_t* place = places.data() + part * tiles;
        for (std::size_t i = runs[part].begin; i < runs[part].end; ++i) {
            const std::uint32_t point = items[i].point;
            for_each_tile(bins.splats[point], bins.columns, [&](int tile) { bins.entries[place[tile]++] = point; });
        }
    });
}

}  // namespace

std::size_t Bins::reach(std::size_t point) const {
    const Range across = tile_range(splats[point].column_first, splats[point].column_last);
    const Range down = tile_range(splats[point].row_first, splats[point].row_last);
    return static_cast<std::size_t>(across.last - across.first + 1) * (down.last - down.first + 1);
}

std::size_t Bins::rank(std::size_t point, int column, int row) const {
    const Range across = tile_range(splats[point].column_first, splats[point].column_last);
    const int top = splats[point].row_first / kTile;
    return static_cast<std::size_t>(row - top) * (across.last - across.first + 1) + (column - across.first);
}

Bins bin_points(const Cloud& cloud, const Settings& settings, Team& team) {
    Bins bins;
    bins.columns = (settings.camera.width + kTile - 1) / kTile;
    bins.rows = (settings.camera.height + kTile - 1) / kTile;
    bins.splats = Buffer<Splat>(cloud.count);
    bins.visible = Buffer<std::uint8_t>(cloud.count);
    bins.tile_begin = Buffer<std::size_t>(static_cast<std::size_t>(bins.tiles()) + 1);
    Buffer<Item> items(cloud.count), spare(cloud.count);
    const std::vector<Run> runs = project_all(cloud, settings, team, bins, items.data());
    std::size_t count = 0;
    for (const Run& run : runs) count += run.end - run.begin;
    const Item* sorted = sort_items(runs, count, items.data(), spare.data(), team);
    fill_tiles(sorted, count, team, bins);
    return bins;
}

}  // namespace fourd::points
