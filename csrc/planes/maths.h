// Bilinear lookup in feature planes, the same for every backend; as torch's grid_sample does with
// align_corners and border padding.
#pragma once

#include <cstddef>

#include "common/host_device.h"

namespace fourd::planes {

// A plane over two of a query's four coordinates: values (rows, columns, features), at least 2 x 2.
struct Plane {
    const float* values;
    int columns, rows;
    int across, down;  // which coordinates, 0 to 3, run along columns and rows
};

// Where a coordinate falls between two samples: (1 - share) of the one at low, share of the next.
struct Between {
    int low;
    float share;
    float slope;  // samples per unit of the coordinate; 0 where it was clamped to the border
};

// size samples lie evenly on [-1, 1]. What is no number counts as -1.
FOURD_HD static inline Between between(float coordinate, int size) {
    const float last = static_cast<float>(size - 1);
    float place = (coordinate + 1.0f) * 0.5f * last;
    const bool inside = place > 0.0f && place < last;
    place = place > 0.0f ? place : 0.0f;
    place = place < last ? place : last;
    int low = static_cast<int>(place);
    low = low < size - 2 ? low : size - 2;
    return {low, place - static_cast<float>(low), inside ? 0.5f * last : 0.0f};
}

// The four samples around a query and their weights: [row][column].
struct Corners {
    std::size_t top, bottom;  // offsets of the left samples of both rows; the right ones follow
    float weight[2][2];
};

FOURD_HD static inline Corners corners(const Plane& plane, const Between& x, const Between& y, int features) {
    Corners out;
    out.top = (static_cast<std::size_t>(y.low) * plane.columns + x.low) * features;
    out.bottom = out.top + static_cast<std::size_t>(plane.columns) * features;
    out.weight[0][0] = (1.0f - x.share) * (1.0f - y.share);
    out.weight[0][1] = x.share * (1.0f - y.share);
    out.weight[1][0] = (1.0f - x.share) * y.share;
    out.weight[1][1] = x.share * y.share;
    return out;
}

}  // namespace fourd::planes
