// The maths of interpolation, shared by every backend.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/triangle_id.h"

namespace fourd::interpolate {

// For each vertex of a triangle, the index of the vertex's first attribute in the attribute array (vertices, channels)
// of an image.
struct Corners {
    std::size_t at[3];
    bool is_valid;  // False for the background, or if the index of the triangle or of a vertex is out of range.
};

FOURD_HD static inline Corners corners_of(float id, const std::int32_t* tri, std::size_t triangles,
                                          std::size_t vertices, std::size_t channels) {
    Corners out = {{0, 0, 0}, false};
    const int triangle = triangle_of_value(id);
    if (triangle < 0 || static_cast<std::size_t>(triangle) >= triangles) return out;
    for (std::size_t k = 0; k < 3; ++k) {
        const std::size_t vertex = static_cast<std::uint32_t>(tri[3 * static_cast<std::size_t>(triangle) + k]);
        if (vertex >= vertices) return out;
        out.at[k] = vertex * channels;
    }
    out.is_valid = true;
    return out;
}

FOURD_HD static inline float mix(float a0, float a1, float a2, float u, float v) {
    return (u * a0 + v * a1) + ((1.0f - u) - v) * a2;
}

}  // namespace fourd::interpolate
