#include "points/cpu/bins.h"

#include <algorithm>

#include "common/inline.h"

namespace fourd::points {
namespace {

struct KeyRange {
    std::uint32_t low = ~0u, high = 0;

    void add(std::uint32_t from, std::uint32_t to) {
        low = std::min(low, from);
        high = std::max(high, to);
    }
};

// Calls visit(tile) for each tile of a tile range.
template <typename Visit>
void for_each_tile(const TileRange& range, int columns, Visit visit) {
    for (int row = range.top; row <= range.bottom; ++row) {
        for (int column = range.left; column <= range.right; ++column) visit(row * columns + column);
    }
}

}  // namespace

std::vector<Bins::Run> Bins::split(std::size_t count, int parts) {
    std::vector<Run> runs;
    for (int part = 0; part < parts; ++part) {
        runs.push_back({count * part / parts, count * (part + 1) / parts});
    }
    return runs;
}

// Projects all points and returns spans of items. The spans contain only the items of visible points.
std::vector<Bins::Run> Bins::project_all(const Cloud& cloud, const Settings& settings, Team& team) {
    const Loops& loops = select_loops(settings.simd);
    std::vector<Run> runs = split(cloud.count, team.size());
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        Run& run = runs[part];
        run.end = run.begin + loops.project(cloud, settings, run.begin, run.end, splats_.data(), tile_ranges_.data(),
                                            items_.data() + run.begin);
    });
    visible_ = 0;
    for (const Run& run : runs) visible_ += run.end - run.begin;
    return runs;
}

// Runs one stable pass of the radix sort, from items_ to spare_. The digit of an item consists of the bits of (key -
// low) that start at bit `shift`.
void Bins::radix_pass(const std::vector<Run>& runs, std::uint32_t low, int shift, int bits, Team& team) {
    const Item* const from = items_.data();
    Item* const to = spare_.data();
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
    std::swap(items_, spare_);
}

// Sorts the items of all spans stably by key. The sorted items are contiguous.
void Bins::sort(std::vector<Run> runs, Team& team) {
    std::vector<KeyRange> ranges(runs.size());
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        KeyRange here;
        for (std::size_t i = runs[part].begin; i < runs[part].end; ++i) here.add(items_[i].key, items_[i].key);
        ranges[part] = here;
    });
    KeyRange all;
    for (const KeyRange& range : ranges) all.add(range.low, range.high);
    const std::uint32_t low = all.low, high = all.high;
    int bits = 0;
    while (visible_ > 0 && bits < 32 && ((high - low) >> bits) != 0) ++bits;
    constexpr int kMaxBits = 12;  // With 12 bits, a histogram has 4096 counters and stays in the L1 cache.
    const int passes = std::max(1, (bits + kMaxBits - 1) / kMaxBits);
    const int digit = std::max(1, (bits + passes - 1) / passes);
    for (int pass = 0; pass < passes; ++pass) {
        radix_pass(runs, low, pass * digit, digit, team);
        runs = split(visible_, team.size());
    }
}

// Counts, for each part, the entries of every tile. The function also copies the tile ranges into the order of ranks.
std::vector<std::size_t> Bins::count_entries(const std::vector<Run>& runs, Team& team) {
    constexpr std::size_t kAhead = 32;
    const std::size_t count = static_cast<std::size_t>(tiles());
    std::vector<std::size_t> counts(runs.size() * count, 0);
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        std::size_t* here = counts.data() + part * count;
        for (std::size_t rank = runs[part].begin; rank < runs[part].end; ++rank) {
            if (rank + kAhead < runs[part].end) prefetch(&tile_ranges_[items_[rank + kAhead].point]);
            const TileRange range = tile_ranges_[items_[rank].point];
            ranked_tile_ranges_[rank] = range;
            for_each_tile(range, columns_, [&](int tile) { ++here[tile]; });
        }
    });
    return counts;
}

// Writes the entries of all tiles. In each tile, the entries of a part follow the entries of the previous parts. The
// argument `places` has the counts from count_entries.
void Bins::fill_tiles(const std::vector<Run>& runs, std::vector<std::size_t> places, Team& team) {
    const std::size_t count = static_cast<std::size_t>(tiles());
    std::size_t total = 0;
    for (std::size_t tile = 0; tile < count; ++tile) {
        tile_begin_[tile] = total;
        for (std::size_t part = 0; part < runs.size(); ++part) {
            std::size_t& place = places[part * count + tile];
            const std::size_t here = place;
            place = total;
            total += here;
        }
    }
    tile_begin_[count] = total;
    entries_.require(total);
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        std::size_t* place = places.data() + part * count;
        for (std::size_t rank = runs[part].begin; rank < runs[part].end; ++rank) {
            const std::uint32_t point = items_[rank].point;
            for_each_tile(ranked_tile_ranges_[rank], columns_, [&](int tile) { entries_[place[tile]++] = point; });
        }
    });
}

void Bins::sort_points(const Cloud& cloud, const Settings& settings, Team& team) {
    splats_.require(cloud.count);
    tile_ranges_.require(cloud.count);
    items_.require(cloud.count);
    spare_.require(cloud.count);
    sort(project_all(cloud, settings, team), team);
}

void Bins::fill(const Cloud& cloud, const Settings& settings, Team& team) {
    columns_ = (settings.camera.width + kTile - 1) / kTile;
    rows_ = (settings.camera.height + kTile - 1) / kTile;
    ranked_tile_ranges_.require(cloud.count);
    tile_begin_.require(static_cast<std::size_t>(tiles()) + 1);
    sort_points(cloud, settings, team);
    const std::vector<Run> runs = split(visible_, team.size());
    fill_tiles(runs, count_entries(runs, team), team);
}

std::size_t Bins::bytes() const {
    return sizeof(Splat) * splats_.size() + sizeof(TileRange) * (tile_ranges_.size() + ranked_tile_ranges_.size()) +
           sizeof(Item) * (items_.size() + spare_.size()) + sizeof(std::uint32_t) * entries_.size() +
           sizeof(std::size_t) * tile_begin_.size();
}

}  // namespace fourd::points
