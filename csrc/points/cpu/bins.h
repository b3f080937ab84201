// Projects points, sorts them by depth and bins them into tiles of 16 x 16 pixels. An entry is one (point, tile) pair.
#pragma once

#include <cstdint>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "points/cpu/tiles.h"
#include "points/points.h"

namespace fourd::points {

// The rank of a visible point is its position in depth order. The nearest point has rank 0, and points of equal depth
// are ranked by index. The buffers are kept between images and may be larger than their contents.
class Bins {
  public:
    // Projects, sorts and bins; replaces the previous contents.
    void fill(const Cloud& cloud, const Settings& settings, Team& team);

    // Projects and sorts only, which fills order().
    void sort_points(const Cloud& cloud, const Settings& settings, Team& team);
    const Item* order() const { return items_.data(); }  // indexed by rank

    int columns() const { return columns_; }  // number of tiles per row
    int tiles() const { return columns_ * rows_; }
    std::size_t visible() const { return visible_; }        // number of visible points
    const Splat* splats() const { return splats_.data(); }  // indexed by point; valid only for visible points
    const TileRange& tile_range(std::size_t point) const { return tile_ranges_[point]; }
    const std::size_t* tile_begin() const { return tile_begin_.data(); }  // (tiles + 1,) offsets into entries
    const std::uint32_t* entries() const { return entries_.data(); }      // each tile's points, in the order of ranks

    std::size_t bytes() const;  // of the memory that is kept

  private:
    // A span of consecutive items. In each pass, one thread processes the span. Spans are merged in order, so that the
    // result does not depend on the number of spans.
    struct Run {
        std::size_t begin, end;
    };

    static std::vector<Run> split(std::size_t count, int parts);
    std::vector<Run> project_all(const Cloud& cloud, const Settings& settings, Team& team);
    void radix_pass(const std::vector<Run>& runs, std::uint32_t low, int shift, int bits, Team& team);
    void sort(std::vector<Run> runs, Team& team);
    std::vector<std::size_t> count_entries(const std::vector<Run>& runs, Team& team);
    void fill_tiles(const std::vector<Run>& runs, std::vector<std::size_t> places, Team& team);

    int columns_ = 0, rows_ = 0;
    std::size_t visible_ = 0;
    Buffer<Splat> splats_;
    Buffer<TileRange> tile_ranges_, ranked_tile_ranges_;  // by point, by rank
    Buffer<Item> items_, spare_;
    Buffer<std::uint32_t> entries_;
    Buffer<std::size_t> tile_begin_;
};

}  // namespace fourd::points
