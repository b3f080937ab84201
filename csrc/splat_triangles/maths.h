// The maths of triangle splatting, shared by every backend. fourd/rendering/ops/splat_triangles/reference.py computes the same
// float32 numbers in the same order, so that kernel and reference find the same hits.
//
// A projected triangle has the incentre s and the inradius r. phi_k(p) is the signed distance of a pixel p from edge k,
// which is negative inside the triangle. At the incentre, phi_k(s) = -r for every edge. The quotient
//     a_k(p) = phi_k(p) / phi_k(s)
// is therefore 1 at the incentre and 0 on edge k. It is the linear function
//     a_k(p) = 1 + slope_x[k] * (p.x - s.x) + slope_y[k] * (p.y - s.y).
// The alpha of the triangle at p is
//     opacity * max(min_k a_k(p), 0)^sigma.
// With the barycentric coordinates lambda_k, the edge lengths l_k and the perimeter P, the quotient is
//     a_k = lambda_k * P / l_k
// for both orientations of the triangle.
//
// Templates work on single floats and on vectors of floats (tiles/lanes.h). All functions are static, because they are
// compiled once per instruction set (common/dispatch.h).
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "common/host_device.h"
#include "tiles/corners.h"

namespace fourd::splat_triangles {

constexpr float kMaxAlpha = 0.99f;            // Alpha is clamped to this value, so farther triangles keep a gradient.
constexpr float kInverseMinAlpha = 255.0f;    // A triangle is skipped at pixels where its alpha is below 1 / 255.
constexpr float kMinTransmittance = 1e-4f;    // Compositing of a pixel ends at or below this transmittance.
// A triangle is skipped at pixels where min_k a_k is below this value, because such small values are mostly rounding
// errors.
constexpr float kSmallestWindow = 1e-7f;
constexpr float kLn2 = 0.693147181f;

using tiles::constant;
using tiles::Corners;
using tiles::corners_backward;
using tiles::corners_of;
using tiles::Edges;
using tiles::edges_of;
using tiles::exp2_of;
using tiles::is_in_range;
using tiles::log2_of;
using tiles::maximum;
using tiles::minimum;
using tiles::Pinhole;
using tiles::select;
using tiles::tile_span;

// A projected triangle.
struct alignas(64) Splat {
    float x, y;                  // Incentre in pixels.
    float slope_x[3], slope_y[3];
    float opacity, sigma;
    float smallest;  // The triangle hits the pixels where min_k a_k is at least `smallest`.
    float z;         // Mean camera depth of the three corners.
    tiles::TileRange range;
};

FOURD_HD static inline tiles::TileRange tile_range_of(const Splat& splat) { return splat.range; }

// Sums of gradients over the pixels of a triangle. Let g_k be the gradient of the loss with respect to a_k at the pixel
// p, and s the incentre. The members `a`, `ax` and `ay` are the sums of g_k, g_k * (p.x - s.x) and g_k * (p.y - s.y).
struct ShapeGradient {
    float a[3], ax[3], ay[3];
    float opacity, sigma;
};

// A triangle after projection. If `visible` is false, the other members are undefined.
template <typename Number, typename Condition>
struct Projection {
    Number x, y, slope_x[3], slope_y[3], smallest, z;
    Number left, right, top, bottom;  // Inclusive range of tiles, as whole numbers.
    Condition visible;
};

// Projects a triangle. A triangle with a NaN coordinate is not visible, because all comparisons with NaN are false.
template <typename Number>
FOURD_HD static inline auto project(const Pinhole& camera, float near_depth, const Corners<Number>& at, Number opacity,
                                    Number sigma) {
    const Number* const tag = nullptr;
    constexpr float kMaxFloat = 3.402823466e38f;
    const Edges<Number> edges = edges_of(at);
    const Number zero = constant(0.0f, tag), one = constant(1.0f, tag);
    const Number scaled_opacity = opacity * constant(kInverseMinAlpha, tag);
    const auto visible = is_in_range(at, edges, near_depth) & (scaled_opacity >= one) &
                         (constant(kMaxFloat, tag) >= scaled_opacity) & (sigma > zero) &
                         (constant(kMaxFloat, tag) >= sigma);
    Projection<Number, std::decay_t<decltype(visible)>> out;
    out.x = at.u[0] + (edges.length[1] * edges.x[2] - edges.length[2] * edges.x[1]) / edges.perimeter;
    out.y = at.v[0] + (edges.length[1] * edges.y[2] - edges.length[2] * edges.y[1]) / edges.perimeter;
    for (int k = 0; k < 3; ++k) {
        const Number scale = edges.perimeter / (edges.doubled_area * edges.length[k]);
        out.slope_x[k] = zero - edges.y[k] * scale;
        out.slope_y[k] = edges.x[k] * scale;
    }
    const Number power = exp2_of((zero - log2_of(maximum(scaled_opacity, one))) / sigma);
    out.smallest = maximum(power, constant(kSmallestWindow, tag));
    out.z = (at.z[0] + at.z[1] + at.z[2]) / constant(3.0f, tag);
    const Number left = minimum(minimum(at.u[0], at.u[1]), at.u[2]);
    const Number right = maximum(maximum(at.u[0], at.u[1]), at.u[2]);
    const Number top = minimum(minimum(at.v[0], at.v[1]), at.v[2]);
    const Number bottom = maximum(maximum(at.v[0], at.v[1]), at.v[2]);
    const auto across = tile_span(left, right, camera.width, zero, &out.left, &out.right);
    const auto down = tile_span(top, bottom, camera.height, zero, &out.top, &out.bottom);
    out.visible = visible & across & down;
    return out;
}

// The smallest a_k at a pixel, the index k of its edge, and the vector (dx, dy) from the incentre to the pixel. If
// several edges have the smallest a_k, `edge` is the smallest of their indices.
struct Window {
    float dx, dy, smallest;
    int edge;
};

FOURD_HD static inline Window window_at(const Splat& splat, float x, float y) {
    const float dx = x - splat.x, dy = y - splat.y;
    float a[3];
    for (int k = 0; k < 3; ++k) a[k] = 1.0f + splat.slope_x[k] * dx + splat.slope_y[k] * dy;
    const float rest = minimum(a[1], a[2]);
    const int edge = a[0] <= rest ? 0 : a[1] <= a[2] ? 1 : 2;
    return {dx, dy, minimum(a[0], rest), edge};
}

// How a triangle covers a pixel: `falloff` is the smallest a_k to the power sigma, and `unclamped` is the alpha before
// it is clamped to kMaxAlpha. If alpha is 0, the triangle does not hit the pixel, and the values of `falloff` and
// `unclamped` are undefined.
struct PixelCoverage {
    Window window;
    float falloff, unclamped, alpha;
};

FOURD_HD static inline PixelCoverage pixel_coverage(const Splat& splat, float x, float y) {
    PixelCoverage out{window_at(splat, x, y), 0.0f, 0.0f, 0.0f};
    if (!(out.window.smallest >= splat.smallest)) return out;
    out.falloff = exp2_of(splat.sigma * log2_of(out.window.smallest));
    out.unclamped = splat.opacity * out.falloff;
    out.alpha = minimum(out.unclamped, kMaxAlpha);
    return out;
}

// Computes the gradients with respect to the three vertex positions of a triangle from `sums`, the sums over the pixels
// of the triangle. Writes these gradients to `out` (3, 3).
FOURD_HD static inline void project_backward(const Pinhole& camera, const Corners<float>& at, const Splat& splat,
                                             const ShapeGradient& sums, float* out) {
    const Edges<float> edges = edges_of(at);
    const float perimeter = edges.perimeter, area = edges.doubled_area;
    float to_x = 0.0f, to_y = 0.0f;  // Gradient with respect to the incentre.
    for (int k = 0; k < 3; ++k) {
        to_x -= splat.slope_x[k] * sums.a[k];
        to_y -= splat.slope_y[k] * sums.a[k];
    }
    float to_edge_x[3], to_edge_y[3], to_length[3], to_perimeter = 0.0f, to_area = 0.0f;
    for (int k = 0; k < 3; ++k) {
        const float scale = perimeter / (area * edges.length[k]);
        const float to_scale = edges.x[k] * sums.ay[k] - edges.y[k] * sums.ax[k];
        to_edge_x[k] = scale * sums.ay[k];
        to_edge_y[k] = -scale * sums.ax[k];
        to_perimeter += to_scale * scale / perimeter;
        to_area -= to_scale * scale / area;
        to_length[k] = -to_scale * scale / edges.length[k];
    }
    to_length[1] += (to_x * edges.x[2] + to_y * edges.y[2]) / perimeter;
    to_length[2] -= (to_x * edges.x[1] + to_y * edges.y[1]) / perimeter;
    to_perimeter -= (to_x * (splat.x - at.u[0]) + to_y * (splat.y - at.v[0])) / perimeter;
    to_edge_x[2] += to_x * edges.length[1] / perimeter - to_area * edges.y[1];
    to_edge_y[2] += to_y * edges.length[1] / perimeter + to_area * edges.x[1];
    to_edge_x[1] += to_area * edges.y[2] - to_x * edges.length[2] / perimeter;
    to_edge_y[1] -= to_area * edges.x[2] + to_y * edges.length[2] / perimeter;
    float to_u[3] = {to_x, 0.0f, 0.0f}, to_v[3] = {to_y, 0.0f, 0.0f};
    for (int k = 0; k < 3; ++k) {
        const float along = (to_length[k] + to_perimeter) / edges.length[k];
        const float x = to_edge_x[k] + along * edges.x[k], y = to_edge_y[k] + along * edges.y[k];
        to_u[(k + 2) % 3] += x;
        to_v[(k + 2) % 3] += y;
        to_u[(k + 1) % 3] -= x;
        to_v[(k + 1) % 3] -= y;
    }
    const float to_z[3] = {0.0f, 0.0f, 0.0f};
    corners_backward(camera, at, to_u, to_v, to_z, out);
}

}  // namespace fourd::splat_triangles
