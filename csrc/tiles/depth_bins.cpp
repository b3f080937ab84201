#include "tiles/depth_bins.h"

#include <algorithm>

#include "common/inline.h"

namespace fourd::tiles {
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

std::vector<DepthBins::Run> DepthBins::split(std::size_t count, int parts) {
    std::vector<Run> runs;
    for (int part = 0; part < parts; ++part) {
        runs.push_back({count * part / parts, count * (part + 1) / parts});
    }
    return runs;
}

// Projects all primitives, and writes one item for each visible primitive to items_. Returns the spans of items_ that
// have been written.
std::vector<DepthBins::Run> DepthBins::project_all(std::size_t count, const Project& project, Team& team) {
    std::vector<Run> runs = split(count, team.size());
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        Run& run = runs[part];
        run.end = run.begin + project(run.begin, run.end, tile_ranges_.data(), items_.data() + run.begin);
    });
    visible_ = 0;
    for (const Run& run : runs) visible_ += run.end - run.begin;
    return runs;
}

// Runs one stable pass of the radix sort, from items_ to spare_. The pass sorts the items by one digit of the
// difference `key - low`, where `low` is the smallest key of all items. The digit consists of `bits` bits of this
// difference, and bit `shift` is the lowest of them.
void DepthBins::radix_pass(const std::vector<Run>& runs, std::uint32_t low, int shift, int bits, Team& team) {
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

// Sorts the items of all runs together, stably by key. There may be gaps between the runs, but the sorted sequence has
// none.
void DepthBins::radix_sort(std::vector<Run> runs, Team& team) {
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

// For each span of ranks (positions in depth order), counts the entries of every tile. Also copies the tile ranges to
// ranked_tile_ranges_, in the order of ranks.
std::vector<std::size_t> DepthBins::count_entries(const std::vector<Run>& runs, Team& team) {
    constexpr std::size_t kAhead = 32;
    const std::size_t count = static_cast<std::size_t>(tiles());
    std::vector<std::size_t> counts(runs.size() * count, 0);
    team.run(static_cast<int>(runs.size()), [&](int part, int) {
        std::size_t* here = counts.data() + part * count;
        for (std::size_t rank = runs[part].begin; rank < runs[part].end; ++rank) {
            if (rank + kAhead < runs[part].end) prefetch(&tile_ranges_[items_[rank + kAhead].index]);
            const TileRange range = tile_ranges_[items_[rank].index];
            ranked_tile_ranges_[rank] = range;
            for_each_tile(range, columns_, [&](int tile) { ++here[tile]; });
        }
    });
    return counts;
}

// Writes the entries of the tiles in the rows [top, bottom). In each tile, the entries of a span follow the entries of
// the previous spans. The function overwrites the elements of counts_ that belong to these tiles.
void DepthBins::fill_rows(int top, int bottom, Team& team) {
    const std::size_t count = static_cast<std::size_t>(tiles());
    const std::size_t columns = static_cast<std::size_t>(columns_);
    const std::size_t first = top * columns, last = bottom * columns;
    std::size_t total = 0;
    for (std::size_t tile = first; tile < last; ++tile) {
        tile_begin_[tile] = total;
        for (std::size_t part = 0; part < runs_.size(); ++part) {
            std::size_t& place = counts_[part * count + tile];
            const std::size_t here = place;
            place = total;
            total += here;
        }
    }
    tile_begin_[last] = total;
    entries_.require(total);
    team.run(static_cast<int>(runs_.size()), [&](int part, int) {
        std::size_t* place = counts_.data() + part * count;
        for (std::size_t rank = runs_[part].begin; rank < runs_[part].end; ++rank) {
            const std::uint32_t index = items_[rank].index;
            TileRange range = ranked_tile_ranges_[rank];
            range.top = static_cast<std::uint16_t>(std::max<int>(range.top, top));
            range.bottom = static_cast<std::uint16_t>(std::min<int>(range.bottom, bottom - 1));
            for_each_tile(range, columns_, [&](int tile) { entries_[place[tile]++] = index; });
        }
    });
}

void DepthBins::sort(std::size_t count, const Project& project, Team& team) {
    tile_ranges_.require(count);
    items_.require(count);
    spare_.require(count);
    radix_sort(project_all(count, project, team), team);
}

void DepthBins::prepare(std::size_t count, int width, int height, const Project& project, Team& team) {
    columns_ = (width + kTile - 1) / kTile;
    rows_ = (height + kTile - 1) / kTile;
    ranked_tile_ranges_.require(count);
    tile_begin_.require(static_cast<std::size_t>(tiles()) + 1);
    sort(count, project, team);
    runs_ = split(visible_, team.size());
    counts_ = count_entries(runs_, team);
}

void DepthBins::fill(std::size_t count, int width, int height, const Project& project, Team& team) {
    prepare(count, width, height, project, team);
    fill_rows(0, rows_, team);
}

int DepthBins::fill_band(int top, std::size_t max_entries, Team& team) {
    const std::size_t count = static_cast<std::size_t>(tiles());
    std::size_t total = 0;
    int bottom = top;
    for (; bottom < rows_; ++bottom) {
        std::size_t row = 0;
        for (std::size_t part = 0; part < runs_.size(); ++part) {
            const std::size_t* counts = counts_.data() + part * count + static_cast<std::size_t>(bottom) * columns_;
            for (int column = 0; column < columns_; ++column) row += counts[column];
        }
        if (bottom > top && total + row > max_entries) break;
        total += row;
    }
    fill_rows(top, bottom, team);
    return bottom;
}

std::size_t DepthBins::bytes() const {
    return sizeof(TileRange) * (tile_ranges_.size() + ranked_tile_ranges_.size()) +
           sizeof(Item) * (items_.size() + spare_.size()) + sizeof(std::uint32_t) * entries_.size() +
           sizeof(std::size_t) * tile_begin_.size();
}

std::size_t Slots::assign(const DepthBins& bins, std::size_t count) {
    first_.require(count + 1);
    std::size_t total = 0;
    for (std::size_t index = 0; index < count; ++index) {
        first_[index] = total;
        total += tile_count(bins.tile_range(index));
    }
    first_[count] = total;
    return total;
}

void Slots::of_tile(const DepthBins& bins, int tile, Buffer<std::size_t>& out) const {
    const std::size_t first = bins.tile_begin()[tile], count = bins.tile_begin()[tile + 1] - first;
    const int tile_column = tile % bins.columns(), tile_row = tile / bins.columns();
    out.require(count);
    for (std::size_t entry = 0; entry < count; ++entry) {
        const std::uint32_t index = bins.entries()[first + entry];
        const TileRange& range = bins.tile_range(index);
        const std::size_t column = static_cast<std::size_t>(tile_column) - range.left;
        const std::size_t row = static_cast<std::size_t>(tile_row) - range.top;
        out[entry] = first_[index] + row * tiles_across(range) + column;
    }
}

}  // namespace fourd::tiles
