// Projects triangles to the image. All compositors of triangles share this code.
//
// Templates work on single floats and on vectors of floats (tiles/lanes.h). All functions are static, because they are
// compiled once per instruction set (common/dispatch.h), and the linker would otherwise keep only one of the compiled
// copies.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "tiles/geometry.h"

namespace fourd::tiles {

constexpr float kThinnest = 1e-4f;             // Triangles with an inradius below kThinnest pixels are culled.
constexpr float kFarthestPixel = 16777216.0f;  // Triangles with a pixel coordinate beyond +-2^24 are culled.
constexpr float kMaxDepth = 1e38f;             // Triangles with a vertex at a depth above kMaxDepth are culled.

// Functions on floats. tiles/lanes.h and tiles/powers.inc have the same functions on Lanes.
FOURD_HD static inline float constant(float value, const float*) { return value; }
FOURD_HD static inline float select(bool condition, float a, float b) { return condition ? a : b; }
FOURD_HD static inline float minimum(float a, float b) { return a < b ? a : b; }
FOURD_HD static inline float maximum(float a, float b) { return a > b ? a : b; }
FOURD_HD static inline float square_root(float a) { return sqrtf(a); }
FOURD_HD static inline float log2_of(float a) { return log2f(a); }
FOURD_HD static inline float exp2_of(float a) { return exp2f(a); }

// Rounds `a` down to a whole number. `a` must be between -2^22 and 2^22.
template <typename Number>
FOURD_HD static inline Number floor_of(Number a) {
    const Number* const tag = nullptr;
    // `magic` is 1.5 * 2^23. Floats of this magnitude are integers, so adding `magic` to `a` rounds `a`.
    const Number magic = constant(12582912.0f, tag);
    const Number rounded = (a + magic) - magic;
    return select(rounded > a, rounded - constant(1.0f, tag), rounded);
}

// The vertices of a projected triangle: pixel coordinates (u, v) and camera depths z.
template <typename Number>
struct Corners {
    Number u[3], v[3], z[3];
};

template <typename Number>
FOURD_HD static inline void project_corner(const Pinhole& camera, const Number* xyz, Number* u, Number* v,
                                           Number* z) {
    const Number* const tag = nullptr;
    Number in_camera[3];
    for (int i = 0; i < 3; ++i) {
        const float* row = camera.rotation + 3 * i;
        in_camera[i] = constant(row[0], tag) * xyz[0] + constant(row[1], tag) * xyz[1] +
                       constant(row[2], tag) * xyz[2] + constant(camera.translation[i], tag);
    }
    const float* k = camera.intrinsics;
    const Number x = in_camera[0], y = in_camera[1];
    *z = in_camera[2];
    *u = (constant(k[0], tag) * x + constant(k[1], tag) * y) / *z + constant(k[2], tag);
    *v = (constant(k[3], tag) * x + constant(k[4], tag) * y) / *z + constant(k[5], tag);
}

// The edges of a projected triangle. Edge k is opposite to vertex k. It runs from vertex (k + 1) % 3 to vertex
// (k + 2) % 3.
template <typename Number>
struct Edges {
    Number x[3], y[3], length[3];
    Number perimeter;
    Number doubled_area;  // Twice the signed area.
};

template <typename Number>
FOURD_HD static inline Edges<Number> edges_of(const Corners<Number>& at) {
    Edges<Number> out;
    for (int k = 0; k < 3; ++k) {
        const int from = (k + 1) % 3, to = (k + 2) % 3;
        out.x[k] = at.u[to] - at.u[from];
        out.y[k] = at.v[to] - at.v[from];
        out.length[k] = square_root(out.x[k] * out.x[k] + out.y[k] * out.y[k]);
    }
    out.perimeter = out.length[0] + out.length[1] + out.length[2];
    out.doubled_area = out.x[1] * out.y[2] - out.x[2] * out.y[1];
    return out;
}

// Returns true if a triangle is within the limits near_depth, kMaxDepth, kFarthestPixel and kThinnest. If a coordinate
// is NaN, the result is false, because all comparisons with NaN are false.
template <typename Number>
FOURD_HD static inline auto is_in_range(const Corners<Number>& at, const Edges<Number>& edges, float near_depth) {
    const Number* const tag = nullptr;
    const Number nearest = constant(near_depth, tag), deepest = constant(kMaxDepth, tag);
    const Number low = constant(-kFarthestPixel, tag), high = constant(kFarthestPixel, tag);
    const Number area = maximum(edges.doubled_area, constant(0.0f, tag) - edges.doubled_area);
    auto out = area > constant(kThinnest, tag) * edges.perimeter;
    for (int k = 0; k < 3; ++k) {
        out = out & (at.z[k] >= nearest) & (deepest >= at.z[k]) & (at.u[k] >= low) & (high >= at.u[k]) &
              (at.v[k] >= low) & (high >= at.v[k]);
    }
    return out;
}

// Finds the range of tiles, along one axis, that contain pixel centres from low - margin to high + margin. Returns
// false if the range is empty.
template <typename Number>
FOURD_HD static inline auto tile_span(Number low, Number high, int size, Number margin, Number* first, Number* last) {
    const Number* const tag = nullptr;
    const Number zero = constant(0.0f, tag), half = constant(0.5f, tag);
    const Number end = constant(static_cast<float>(size - 1), tag);
    // The margin is enlarged, because rounding errors in the bounds could otherwise exclude pixels that the triangle
    // hits.
    margin = margin + constant(1e-3f, tag) + (high - low) * constant(1e-5f, tag);
    const Number from = maximum(low - margin - half, zero), to = minimum(high + margin - half, end);
    *first = floor_of(from * constant(1.0f / kTile, tag));
    *last = floor_of(maximum(to, zero) * constant(1.0f / kTile, tag));
    return (to >= zero) & (end >= from) & (to >= from);
}

// Projects the corners of a triangle. `tri` has the three vertex indices.
FOURD_HD static inline Corners<float> corners_of(const Pinhole& camera, const float* xyz,
                                                 const std::int32_t* tri) {
    Corners<float> out;
    for (int k = 0; k < 3; ++k) {
        project_corner(camera, xyz + 3 * static_cast<std::size_t>(tri[k]), out.u + k, out.v + k, out.z + k);
    }
    return out;
}

// Computes the gradients of the vertex positions, and writes them to `out` (3, 3). `to_u`, `to_v` and `to_z` (3,) are
// the gradients of the corners' pixel coordinates (u, v) and camera depths z.
FOURD_HD static inline void corners_backward(const Pinhole& camera, const Corners<float>& at, const float* to_u,
                                             const float* to_v, const float* to_z, float* out) {
    const float* r = camera.rotation;
    const float* m = camera.intrinsics;
    for (int k = 0; k < 3; ++k) {
        const float u = to_u[k] / at.z[k], v = to_v[k] / at.z[k];
        const float x = m[0] * u + m[3] * v, y = m[1] * u + m[4] * v;
        const float z = to_z[k] - (u * (at.u[k] - m[2]) + v * (at.v[k] - m[5]));
        for (int axis = 0; axis < 3; ++axis) out[3 * k + axis] = r[axis] * x + r[3 + axis] * y + r[6 + axis] * z;
    }
}

}  // namespace fourd::tiles
