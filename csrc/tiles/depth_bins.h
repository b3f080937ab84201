// Sorts primitives by depth and bins them into tiles of 16 x 16 pixels. A tile has one entry for each primitive that
// covers the tile.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "tiles/geometry.h"

namespace fourd::tiles {

// The primitives of an image, sorted by depth and binned into tiles. The rank of a visible primitive is its position in
// depth order. The nearest primitive has rank 0, and primitives of equal depth are ranked by index. Buffers are kept
// between images and may be larger than their contents.
class DepthBins {
  public:
    // Projects the primitives [begin, end). Writes the tile range of each primitive to tile_ranges, which is indexed by
    // primitive. Writes one item (depth and index) for each visible primitive to `items`, in index order, and returns
    // the count of these items.
    using Project =
        std::function<std::size_t(std::size_t begin, std::size_t end, TileRange* tile_ranges, Item* items)>;

    // Projects, sorts and bins `count` primitives, and replaces the previous contents.
    void fill(std::size_t count, int width, int height, const Project& project, Team& team);

    // Projects and sorts the primitives like fill(), and counts the entries of the tiles. Call fill_band afterwards,
    // for all rows of tiles from top to bottom.
    void prepare(std::size_t count, int width, int height, const Project& project, Team& team);

    // Bins the primitives into a band of tile rows that starts at row `top`, and returns the first row after the band.
    // The band has as many rows as possible with at most `max_entries` entries in total, but at least one row. Until
    // the next call, only the rows of the band have entries. Bands are needed because the entries of large primitives
    // in the whole image could exceed the available memory.
    int fill_band(int top, std::size_t max_entries, Team& team);

    // Projects and sorts the primitives, without binning them. order() then returns the sorted items.
    void sort(std::size_t count, const Project& project, Team& team);
    const Item* order() const { return items_.data(); }  // Indexed by rank.

    int columns() const { return columns_; }  // Number of tiles per row.
    int rows() const { return rows_; }        // Number of rows of tiles.
    int tiles() const { return columns_ * rows_; }
    std::size_t visible() const { return visible_; }  // Number of visible primitives.
    const TileRange& tile_range(std::size_t index) const { return tile_ranges_[index]; }
    const std::size_t* tile_begin() const { return tile_begin_.data(); }  // Shape (tiles + 1,): offsets into entries.
    const std::uint32_t* entries() const { return entries_.data(); }  // Primitive indices of each tile, nearest first.

    std::size_t bytes() const;  // Size of the memory that is kept between images.

  private:
    // A span of consecutive items. The passes of the radix sort, and the functions that count and write entries, divide
    // the items into one span per thread. Spans are merged in order, so the result does not depend on the number of
    // spans.
    struct Run {
        std::size_t begin, end;
    };

    static std::vector<Run> split(std::size_t count, int parts);
    std::vector<Run> project_all(std::size_t count, const Project& project, Team& team);
    void radix_pass(const std::vector<Run>& runs, std::uint32_t low, int shift, int bits, Team& team);
    void radix_sort(std::vector<Run> runs, Team& team);
    std::vector<std::size_t> count_entries(const std::vector<Run>& runs, Team& team);
    void fill_rows(int top, int bottom, Team& team);

    int columns_ = 0, rows_ = 0;
    std::size_t visible_ = 0;
    std::vector<Run> runs_;            // Spans of consecutive ranks, one for each thread.
    std::vector<std::size_t> counts_;  // Shape (spans, tiles): the count of entries of each span in each tile.
    Buffer<TileRange> tile_ranges_, ranked_tile_ranges_;  // The first is indexed by primitive, the second by rank.
    Buffer<Item> items_, spare_;
    Buffer<std::uint32_t> entries_;
    Buffer<std::size_t> tile_begin_;
};

// Assigns a slot (an index in an array of results) to each (primitive, tile) entry. When a tile is processed, the
// tile's result for the primitive is written into the slot. The slots of a primitive are adjacent and are summed in a
// fixed order, so the sum does not depend on which thread filled the slots.
class Slots {
  public:
    // Assigns the slots of `count` primitives, and returns the number of slots.
    std::size_t assign(const DepthBins& bins, std::size_t count);

    // Writes to `out` the slots of all entries of the tile with this index. Tiles are numbered row by row.
    void of_tile(const DepthBins& bins, int tile, Buffer<std::size_t>& out) const;

    // The slots of a primitive are [begin(index), end(index)).
    std::size_t begin(std::size_t index) const { return first_[index]; }
    std::size_t end(std::size_t index) const { return first_[index + 1]; }

    std::size_t bytes() const { return sizeof(std::size_t) * first_.size(); }

  private:
    Buffer<std::size_t> first_;
};

}  // namespace fourd::tiles
