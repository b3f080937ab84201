// Points projected, ordered by depth and sorted into 16 x 16 pixel tiles.
#pragma once

#include <cstdint>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "points/cpu/tiles.h"
#include "points/points.h"

namespace fourd::points {

// A visible point's rank is its place from near to far: 0 is the nearest, ties are in the order of their indices.
// The buffers are kept from one picture to the next, and may be larger than what they hold.
class Bins {
  public:
    // Projects, sorts and bins; what was here before is forgotten.
    void fill(const Cloud& cloud, const Settings& settings, Team& team);

    // Projects and sorts alone; order() is what is then there to read.
    void sort_points(const Cloud& cloud, const Settings& settings, Team& team);
    const Item* order() const { return items_.data(); }  // by rank

    int columns() const { return columns_; }  // tiles across
    int tiles() const { return columns_ * rows_; }
    std::size_t visible() const { return visible_; }  // how many points are
    const Splat* splats() const { return splats_.data(); }                // by point; of visible ones
    const Reach& reach(std::size_t point) const { return reaches_[point]; }
    const std::size_t* tile_begin() const { return tile_begin_.data(); }  // (tiles + 1,) into entries
    const std::uint32_t* entries() const { return entries_.data(); }      // each tile's points, by rank

    std::size_t bytes() const;  // of memory that is kept

  private:
    // A run of items: each thread's part of a pass. Parts are merged in order, so the result is the
    // same for any number of them.
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
    Buffer<Reach> reaches_, ranked_reaches_;  // by point, by rank
    Buffer<Item> items_, spare_;
    Buffer<std::uint32_t> entries_;
    Buffer<std::size_t> tile_begin_;
};

}  // namespace fourd::points
