// The points of an image, projected, sorted by depth and binned into tiles.
#pragma once

#include "points/cpu/tiles.h"
#include "tiles/depth_bins.h"

namespace fourd::points {

class Bins : public tiles::DepthBins {
  public:
    // Projects, sorts and bins the points of a cloud, and replaces the previous contents.
    void fill(const Cloud& cloud, const Settings& settings, Team& team) {
        splats_.require(cloud.count);
        DepthBins::fill(cloud.count, settings.camera.width, settings.camera.height, projection(cloud, settings), team);
    }

    // Projects and sorts the points, and counts their (point, tile) entries. Call fill_band afterwards.
    void prepare(const Cloud& cloud, const Settings& settings, Team& team) {
        splats_.require(cloud.count);
        DepthBins::prepare(cloud.count, settings.camera.width, settings.camera.height, projection(cloud, settings),
                           team);
    }

    // Projects and sorts the points, without binning them.
    void sort_points(const Cloud& cloud, const Settings& settings, Team& team) {
        splats_.require(cloud.count);
        DepthBins::sort(cloud.count, projection(cloud, settings), team);
    }

    const Splat* splats() const { return splats_.data(); }  // Indexed by point. Only visible points have a valid splat.

    std::size_t bytes() const { return DepthBins::bytes() + sizeof(Splat) * splats_.size(); }

  private:
    Project projection(const Cloud& cloud, const Settings& settings) {
        return [&, project = select_loops(settings.simd).project](std::size_t begin, std::size_t end,
                                                                  TileRange* tile_ranges, Item* items) {
            return project(cloud, settings, begin, end, splats_.data(), tile_ranges, items);
        };
    }

    Buffer<Splat> splats_;
};

}  // namespace fourd::points
