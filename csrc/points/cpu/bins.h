// Points projected, ordered by depth and sorted into 16 x 16 pixel tiles.
#pragma once

#include <cstdint>

#include "common/buffer.h"
#include "common/team.h"
#include "points/points.h"

namespace fourd::points {

constexpr int kTile = 16;  // a row of a tile is one vector of lanes.h

struct Bins {
    int columns = 0, rows = 0;       // tiles across and down
    Buffer<Splat> splats;            // by point; culled points are not initialised
    Buffer<std::uint8_t> visible;    // by point
    Buffer<std::size_t> tile_begin;  // (columns * rows + 1,) into entries
    Buffer<std::uint32_t> entries;   // points of each tile, nearest first, ties by index

    int tiles() const { return columns * rows; }
    // How many tiles a visible point reaches, and which of them a tile is for it, counted row by row.
    std::size_t reach(std::size_t point) const;
    std::size_t rank(std::size_t point, int column, int row) const;
};

Bins bin_points(const Cloud& cloud, const Settings& settings, Team& team);

}  // namespace fourd::points
