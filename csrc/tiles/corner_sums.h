// Sums, for each vertex, the gradients of the triangle corners at this vertex.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace fourd::tiles {

// `corners` (count, 9) has the gradients of the three corners of each triangle, and `tri` (count, 3) has the vertex
// indices. Sets row v of `xyz` (vertices, 3) to the sum of the gradients of all corners at vertex v, added in the
// order of the triangles.
inline void add_corners(const float* corners, const std::int32_t* tri, std::size_t count, float* xyz,
                        std::size_t vertices) {
    std::fill_n(xyz, 3 * vertices, 0.0f);
    for (std::size_t corner = 0; corner < 3 * count; ++corner) {
        float* to = xyz + 3 * static_cast<std::size_t>(tri[corner]);
        for (std::size_t axis = 0; axis < 3; ++axis) to[axis] += corners[3 * corner + axis];
    }
}

}  // namespace fourd::tiles
