// Projects points and builds their (point, tile) entries, on a GPU.
#pragma once

#include <cstring>

#include "points/cuda/render.h"
#include "tiles/cuda/traversal.h"

namespace fourd::points::cuda {

using Entries = tiles::cuda::Entries<Splat>;
using tiles::cuda::entry_list;
using tiles::cuda::EntryList;
using tiles::cuda::kCulled;
using tiles::cuda::kTilePixels;
using tiles::cuda::Pixel;
using tiles::cuda::pixel_of;

struct ProjectPoint {
    Cloud cloud;
    Pinhole camera;
    float near_depth;
    Entries to;

    FOURD_DEVICE void operator()(std::size_t point) const {
        const Projection at =
            project(camera, near_depth, cloud.xyz + 3 * point, cloud.radius[point], cloud.density[point]);
        std::uint32_t key = kCulled;
        if (at.visible) memcpy(&key, &at.z, sizeof key);
        to.by_index[point] = at.visible ? splat_of(at) : Splat{};
        to.keys[point] = key;
        to.values[point] = static_cast<std::uint32_t>(point);
    }
};

// Builds the entries of a cloud of points: one entry for each point and each image tile that the point covers. Also
// allocates Entries::sums with `sums` floats per point, for the gradients that the
// backward pass sums over pixels.
inline Entries fill(const device::Executor& executor, const Cloud& cloud, const Settings& settings,
                    const EntryBuffer& buffer, int sums) {
    return tiles::cuda::fill<Splat>(
        executor, cloud.count, settings.camera.width, settings.camera.height, buffer, sums,
        [&](const Entries& to) { return ProjectPoint{cloud, settings.camera, settings.near_depth, to}; });
}

}  // namespace fourd::points::cuda
