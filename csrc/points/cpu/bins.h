// Projects points, sorts them by depth and bins them into tiles of 16 x 16 pixels. A tile has one entry for each point
// that covers the tile.
#pragma once

#include <cstdint>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "points/cpu/tiles.h"
#include "points/points.h"

namespace fourd::points {

// The points of an image, sorted by depth and binned into tiles. The rank of a visible point is its position in depth
// order. The nearest point has rank 0, and points of equal depth are ranked by index. Buffers are kept between images
// and may be larger than their contents.
class Bins {
  public:
    // Projects, sorts and bins the points of a cloud, and replaces the previous contents.
    void fill(const Cloud& cloud, const Settings& settings, Team& team);

    // Projects and sorts the points, without binning them. order() then returns the sorted items.
    void sort_points(const Cloud& cloud, const Settings& settings, Team& team);
    const Item* order() const { return items_.data(); }  // Indexed by rank.

    int columns() const { return columns_; }  // Number of tiles per row.
    int tiles() const { return columns_ * rows_; }
    std::size_t visible() const { return visible_; }        // Number of visible points.
    const Splat* splats() const { return splats_.data(); }  // Indexed by point. Only visible points have a valid splat.
    const TileRange& tile_range(std::size_t point) const { return tile_ranges_[point]; }
    const std::size_t* tile_begin() const { return tile_begin_.data(); }  // (tiles + 1,): offsets into entries.
    const std::uint32_t* entries() const { return entries_.data(); }      // Points of each tile, in the order of ranks.

    std::size_t bytes() const;  // Size of the memory that is kept between images.

  private:
    // A span of consecutive items, which one thread processes in each pass. Spans are merged in order, so the result
    // does not depend on the number of spans.
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
    Buffer<TileRange> tile_ranges_, ranked_tile_ranges_;  // Indexed by point, and by rank.
    Buffer<Item> items_, spare_;
    Buffer<std::uint32_t> entries_;
    Buffer<std::size_t> tile_begin_;
};

}  // namespace fourd::points
