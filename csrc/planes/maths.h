// Bilinear lookup in feature planes, shared by every backend. The lookup gives the same results as grid_sample of torch
// with align_corners=True and border padding.
#pragma once

#include <cstddef>

#include "common/host_device.h"

namespace fourd::planes {

// A feature plane over two of the four coordinates of a query. `values` has the shape (rows, columns, features), with
// at least 2 rows and 2 columns.
struct Plane {
    const float* values;
    int columns, rows;
    int x_axis, y_axis;  // Indices (0 to 3) of the coordinates that select the column and the row.
};

// The linear interpolation between the two samples around a coordinate. The sample with the index `low` has the weight
// 1 - fraction, and the next sample has the weight `fraction`.
struct Interpolation {
    int low;
    float fraction;
    float slope;  // Samples per unit of the coordinate, or 0 if the coordinate was clamped.
};

// Finds the two samples around a coordinate, where `size` samples are evenly spaced on [-1, 1]. NaN counts as -1.
FOURD_HD static inline Interpolation interpolate_axis(float coordinate, int size) {
    const float last = static_cast<float>(size - 1);
    float position = (coordinate + 1.0f) * 0.5f * last;
    const bool inside = position > 0.0f && position < last;
    position = position > 0.0f ? position : 0.0f;
    position = position < last ? position : last;
    int low = static_cast<int>(position);
    low = low < size - 2 ? low : size - 2;
    return {low, position - static_cast<float>(low), inside ? 0.5f * last : 0.0f};
}

// The four samples around a position, with weights indexed as [row][column].
struct Corners {
    std::size_t top, bottom;  // Offsets of the left samples. Each right sample follows its left sample in memory.
    float weight[2][2];
};

FOURD_HD static inline Corners corners(const Plane& plane, const Interpolation& x, const Interpolation& y,
                                       int features) {
    Corners out;
    out.top = (static_cast<std::size_t>(y.low) * plane.columns + x.low) * features;
    out.bottom = out.top + static_cast<std::size_t>(plane.columns) * features;
    out.weight[0][0] = (1.0f - x.fraction) * (1.0f - y.fraction);
    out.weight[0][1] = x.fraction * (1.0f - y.fraction);
    out.weight[1][0] = (1.0f - x.fraction) * y.fraction;
    out.weight[1][1] = x.fraction * y.fraction;
    return out;
}

}  // namespace fourd::planes
