// What is done with a run of points or with a plane, as plain loops over features that compilers turn
// into vectors. The instruction set is that of the function that this is inlined into.
#pragma once

#include <cstdint>

#include "common/inline.h"
#include "planes/planes.h"

namespace fourd::planes {

// Points in the order of their place in space, so that neighbours in it share cache lines of the planes.
struct Run {
    const std::uint32_t* order;
    std::size_t begin, end;
};

// Features is their number, or 0 for what the query says.
template <int Features>
FOURD_INLINE void sample_run(const Query& query, const Run& run, float* out) {
    const int features = Features > 0 ? Features : query.features;
    const std::size_t width = static_cast<std::size_t>(query.plane_count) * features;
    for (std::size_t i = run.begin; i < run.end; ++i) {
        const float* at = query.coordinates + 4 * static_cast<std::size_t>(run.order[i]);
        float* to = out + width * run.order[i];
        for (int k = 0; k < query.plane_count; ++k, to += features) {
            const Plane& plane = query.planes[k];
            const Between x = between(at[plane.across], plane.columns), y = between(at[plane.down], plane.rows);
            const Corners c = corners(plane, x, y, features);
            const float* top = plane.values + c.top;
            const float* bottom = plane.values + c.bottom;
            for (int f = 0; f < features; ++f) {
                to[f] = (c.weight[0][0] * top[f] + c.weight[0][1] * top[features + f]) +
                        (c.weight[1][0] * bottom[f] + c.weight[1][1] * bottom[features + f]);
            }
        }
    }
}

template <int Features>
FOURD_INLINE void coordinate_gradient_run(const Query& query, const Run& run, const float* gradient, float* out) {
    const int features = Features > 0 ? Features : query.features;
    const std::size_t width = static_cast<std::size_t>(query.plane_count) * features;
    for (std::size_t i = run.begin; i < run.end; ++i) {
        const float* at = query.coordinates + 4 * static_cast<std::size_t>(run.order[i]);
        const float* from = gradient + width * run.order[i];
        float total[4] = {0, 0, 0, 0};
        for (int k = 0; k < query.plane_count; ++k, from += features) {
            const Plane& plane = query.planes[k];
            const Between x = between(at[plane.across], plane.columns), y = between(at[plane.down], plane.rows);
            const Corners c = corners(plane, x, y, features);
            const float* top = plane.values + c.top;
            const float* bottom = plane.values + c.bottom;
            float along_top = 0, along_bottom = 0, down_left = 0, down_right = 0;
            for (int f = 0; f < features; ++f) {
                along_top += from[f] * (top[features + f] - top[f]);
                along_bottom += from[f] * (bottom[features + f] - bottom[f]);
                down_left += from[f] * (bottom[f] - top[f]);
                down_right += from[f] * (bottom[features + f] - top[features + f]);
            }
            total[plane.across] += x.slope * (along_top + y.share * (along_bottom - along_top));
            total[plane.down] += y.slope * (down_left + x.share * (down_right - down_left));
        }
        for (int axis = 0; axis < 4; ++axis) out[4 * static_cast<std::size_t>(run.order[i]) + axis] = total[axis];
    }
}

// Adds a plane's share of the gradient to out, which is like the plane's values. One thread does the
// whole plane: nothing to lock, and sums taken in one order.
template <int Features>
FOURD_INLINE void scatter_plane(const Query& query, const Run& run, int k, const float* gradient, float* out) {
    const int features = Features > 0 ? Features : query.features;
    const std::size_t width = static_cast<std::size_t>(query.plane_count) * features;
    const Plane& plane = query.planes[k];
    for (std::size_t i = run.begin; i < run.end; ++i) {
        const float* at = query.coordinates + 4 * static_cast<std::size_t>(run.order[i]);
        const float* from = gradient + width * run.order[i] + static_cast<std::size_t>(k) * features;
        const Between x = between(at[plane.across], plane.columns), y = between(at[plane.down], plane.rows);
        const Corners c = corners(plane, x, y, features);
        float* top = out + c.top;
        float* bottom = out + c.bottom;
        for (int f = 0; f < features; ++f) top[f] += c.weight[0][0] * from[f];
        for (int f = 0; f < features; ++f) top[features + f] += c.weight[0][1] * from[f];
        for (int f = 0; f < features; ++f) bottom[f] += c.weight[1][0] * from[f];
        for (int f = 0; f < features; ++f) bottom[features + f] += c.weight[1][1] * from[f];
    }
}

}  // namespace fourd::planes
