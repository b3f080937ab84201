// The maths of soft rasterization (SoftRas, Liu et al. 2019), shared by every backend.
// fourd/rendering/ops/soft_triangles/reference.py computes the same float32 numbers in the same order.
//
// The parameters sigma, gamma, near and far are arguments of rasterize_soft (fourd/rendering/triangles/soft.py).
//
// The coverage of the pixel p by a triangle is D = sigmoid(x), with
//     x = d^2 / sigma inside the triangle, and x = -d^2 / sigma outside.
// If Softness::barycentric is true, d is the smallest barycentric coordinate of p. Otherwise, d is the distance of p
// from the nearest edge, in a unit in which the shorter side of the image has the length 2.
//
// The inverse 1 / z of the triangle's depth at p is interpolated linearly in the image, with barycentric coordinates
// that are clamped to at least 0 and normalised to the sum 1. With per_depth = 1 / ((far - near) * gamma), the weight
// of the triangle is
//     D * exp(-z * per_depth).
// The weight in the paper, D * exp((far - z) * per_depth), is larger by the constant factor exp(far * per_depth).
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

namespace fourd::soft_triangles {

constexpr float kLog2E = 1.44269504f;
constexpr float kNoHit = 3.4e38f;  // The depth at pixels that a triangle does not hit.
constexpr int kShapeSums = 9;      // Number of gradient sums per triangle: the members of ShapeGradient.

using tiles::constant;
using tiles::Corners;
using tiles::corners_backward;
using tiles::corners_of;
using tiles::Edges;
using tiles::edges_of;
using tiles::exp2_of;
using tiles::is_in_range;
using tiles::maximum;
using tiles::minimum;
using tiles::Pinhole;
using tiles::select;
using tiles::tile_span;

struct Softness {
    bool barycentric;        // Whether d is the smallest barycentric coordinate.
    // The ratio |x| / d^2. If d is a barycentric coordinate, the ratio is 1 / sigma. Otherwise, the code computes d in
    // pixels, and the ratio is s^2 / sigma, where s is the side of a pixel in a unit in which the shorter side of the
    // image has the length 2.
    float sharpness;
    float cut;               // A triangle hits the pixels where x >= -cut.
    float reach;             // Largest |d| at which a triangle hits a pixel outside the triangle.
    float per_depth;         // Equal to 1 / ((far - near) * gamma).
    float far_depth;         // A triangle hits a pixel only if its depth z at the pixel is at most far_depth.
    float background_depth;  // The background has the weight of a triangle with D = 1 at the depth background_depth.
};

// A projected triangle. Index k stands for the vertex k, or for the edge opposite to it.
struct alignas(64) Face {
    float x, y;          // Centroid in pixels.
    float u[3], v[3];    // Corners in pixels, relative to the centroid.
    float inverse_z[3];  // Reciprocals of the camera depths of the corners.
    float inverse_area;  // Equal to 1 / (2 * signed area).
    float inverse_square[3];     // Reciprocals of the squared lengths of the edges.
    // If Softness::barycentric is true, element k is the derivative of barycentric coordinate k of a pixel. Otherwise,
    // element k is the derivative of the pixel's signed distance, in pixels, from edge k. The derivatives are with
    // respect to the horizontal (slope_x) and the vertical (slope_y) position of this pixel.
    float slope_x[3], slope_y[3];
    tiles::TileRange range;
};

FOURD_HD static inline tiles::TileRange tile_range_of(const Face& face) { return face.range; }

// Gradients with respect to the members u, v and inverse_z of a Face, summed over the pixels of the triangle.
struct ShapeGradient {
    float u[3], v[3], inverse_z[3];
};

// A triangle after projection. If `visible` is false, the other members are undefined.
template <typename Number, typename Condition>
struct Projection {
    Number x, y, u[3], v[3], inverse_z[3], inverse_area, inverse_square[3], slope_x[3], slope_y[3];
    Number left, right, top, bottom;  // Inclusive range of tiles, as whole numbers.
    Condition visible;
};

// Projects a triangle. A triangle with a NaN coordinate is not visible, because all comparisons with NaN are false.
template <typename Number>
FOURD_HD static inline auto project(const Pinhole& camera, float near_depth, const Softness& softness,
                                    const Corners<Number>& at) {
    const Number* const tag = nullptr;
    const Number one = constant(1.0f, tag), zero = constant(0.0f, tag), three = constant(3.0f, tag);
    const Edges<Number> edges = edges_of(at);
    const auto in_range = is_in_range(at, edges, near_depth);
    Projection<Number, std::decay_t<decltype(in_range)>> out;
    out.x = (at.u[0] + at.u[1] + at.u[2]) / three;
    out.y = (at.v[0] + at.v[1] + at.v[2]) / three;
    out.inverse_area = one / edges.doubled_area;
    for (int k = 0; k < 3; ++k) {
        out.u[k] = at.u[k] - out.x;
        out.v[k] = at.v[k] - out.y;
        out.inverse_z[k] = one / at.z[k];
        out.inverse_square[k] = one / (edges.length[k] * edges.length[k]);
        const Number area = maximum(edges.doubled_area, zero - edges.doubled_area);
        const Number unit = softness.barycentric ? one : area / edges.length[k];
        out.slope_x[k] = zero - edges.y[k] * out.inverse_area * unit;
        out.slope_y[k] = edges.x[k] * out.inverse_area * unit;
    }
    // If d is a barycentric coordinate, the pixels that the triangle hits lie inside the triangle scaled about its
    // centroid by 1 + 3 * reach.
    const Number scale = constant(softness.barycentric ? 1.0f + 3.0f * softness.reach : 1.0f, tag);
    const Number margin = constant(softness.barycentric ? 0.0f : softness.reach, tag);
    const Number left = minimum(minimum(out.u[0], out.u[1]), out.u[2]) * scale + out.x;
    const Number right = maximum(maximum(out.u[0], out.u[1]), out.u[2]) * scale + out.x;
    const Number top = minimum(minimum(out.v[0], out.v[1]), out.v[2]) * scale + out.y;
    const Number bottom = maximum(maximum(out.v[0], out.v[1]), out.v[2]) * scale + out.y;
    const auto across = tile_span(left, right, camera.width, margin, &out.left, &out.right);
    const auto down = tile_span(top, bottom, camera.height, margin, &out.top, &out.bottom);
    out.visible = in_range & across & down;
    return out;
}

// How a triangle covers a pixel.
template <typename Number, typename Condition>
struct Coverage {
    Number lambda[3];          // Barycentric coordinates.
    Number x;                  // Log-odds of D.
    Number depth;              // Camera depth, or kNoHit where the triangle does not hit the pixel.
    Number total;              // Sum of the barycentric coordinates above 0.
    Number inverse_depth;
    // Let q be the point on the edges that is nearest to the pixel p. `along` is the position of q along its edge, from
    // 0 to 1, and (off_x, off_y) is the vector p - q in pixels. If `barycentric` is true, all three members are 0.
    Number along, off_x, off_y;
    Condition nearest[3];      // Whether edge k (or coordinate k, if `barycentric` is true) determines d.
    Condition inside;
};

template <typename Number>
FOURD_HD static inline auto coverage_at(const Face& face, const Softness& softness, Number pixel_x, Number pixel_y) {
    const Number* const tag = nullptr;
    const auto c = [tag](float value) { return constant(value, tag); };
    const Number zero = c(0.0f), one = c(1.0f);
    const Number px = pixel_x - c(face.x), py = pixel_y - c(face.y);
    using Condition = std::decay_t<decltype(zero > one)>;
    Coverage<Number, Condition> out;
    Number to_x[3], to_y[3];  // Vectors from the pixel to the corners.
    for (int k = 0; k < 3; ++k) {
        to_x[k] = c(face.u[k]) - px;
        to_y[k] = c(face.v[k]) - py;
    }
    for (int k = 0; k < 3; ++k) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        out.lambda[k] = (to_x[a] * to_y[b] - to_x[b] * to_y[a]) * c(face.inverse_area);
    }
    const Number smallest = minimum(out.lambda[0], minimum(out.lambda[1], out.lambda[2]));
    out.inside = smallest > zero;
    Number square;
    out.along = out.off_x = out.off_y = zero;
    if (softness.barycentric) {
        square = smallest * smallest;
        out.nearest[0] = smallest >= out.lambda[0];
        out.nearest[1] = (smallest >= out.lambda[1]) & (out.lambda[0] > smallest);
        out.nearest[2] = (out.lambda[0] > smallest) & (out.lambda[1] > smallest);
    } else {
        Number squares[3], along[3], off_x[3], off_y[3];
        for (int k = 0; k < 3; ++k) {
            const int a = (k + 1) % 3, b = (k + 2) % 3;
            const Number edge_x = c(face.u[b] - face.u[a]), edge_y = c(face.v[b] - face.v[a]);
            const Number dot = (zero - to_x[a]) * edge_x + (zero - to_y[a]) * edge_y;
            along[k] = minimum(maximum(dot * c(face.inverse_square[k]), zero), one);
            off_x[k] = zero - to_x[a] - along[k] * edge_x;
            off_y[k] = zero - to_y[a] - along[k] * edge_y;
            squares[k] = off_x[k] * off_x[k] + off_y[k] * off_y[k];
        }
        square = minimum(squares[0], minimum(squares[1], squares[2]));
        out.nearest[0] = square >= squares[0];
        out.nearest[1] = (square >= squares[1]) & (squares[0] > square);
        out.nearest[2] = (squares[0] > square) & (squares[1] > square);
        out.along = select(out.nearest[0], along[0], select(out.nearest[1], along[1], along[2]));
        out.off_x = select(out.nearest[0], off_x[0], select(out.nearest[1], off_x[1], off_x[2]));
        out.off_y = select(out.nearest[0], off_y[0], select(out.nearest[1], off_y[1], off_y[2]));
    }
    const Number scaled = square * c(softness.sharpness);
    out.x = select(out.inside, scaled, zero - scaled);
    Number clamped[3];
    for (int k = 0; k < 3; ++k) clamped[k] = maximum(out.lambda[k], zero);
    out.total = clamped[0] + clamped[1] + clamped[2];
    const Number sum = clamped[0] * c(face.inverse_z[0]) + clamped[1] * c(face.inverse_z[1]) +
                       clamped[2] * c(face.inverse_z[2]);
    out.inverse_depth = sum / out.total;
    const Number depth = one / out.inverse_depth;
    const Condition hit = (out.x >= c(-softness.cut)) & (c(softness.far_depth) >= depth);
    out.depth = select(hit, depth, c(kNoHit));
    return out;
}

// The coverage D = sigmoid(x) of a pixel by a triangle (`covered`), and its complement 1 - D (`open`).
template <typename Number>
struct Odds {
    Number covered, open;
};

template <typename Number>
FOURD_HD static inline Odds<Number> odds_of(Number x) {
    const Number* const tag = nullptr;
    const Number zero = constant(0.0f, tag), one = constant(1.0f, tag);
    const Number power = exp2_of((zero - maximum(x, zero - x)) * constant(kLog2E, tag));
    const Number large = one / (one + power), small = power * large;
    const auto positive = x >= zero;
    return {select(positive, large, small), select(positive, small, large)};
}

// Returns exp((nearest - depth) * per_depth). `nearest` is the smallest depth at the pixel, so the result is at most 1.
// The common factor exp(nearest * per_depth) cancels when weights are normalised.
template <typename Number>
FOURD_HD static inline Number depth_weight(const Softness& softness, Number nearest, Number depth) {
    const Number* const tag = nullptr;
    return exp2_of((nearest - depth) * constant(softness.per_depth * kLog2E, tag));
}

// Adds the gradient of one triangle at a pixel to `sums`, which has the members of ShapeGradient in their order. to_x
// and to_depth are the gradients of the loss with respect to Coverage::x and Coverage::depth. At a pixel that the
// triangle does not hit, both gradients must be 0.
template <typename Number, typename Condition>
FOURD_HD static inline void add_gradient(const Face& face, const Softness& softness, Number pixel_x, Number pixel_y,
                                         const Coverage<Number, Condition>& at, Number to_x, Number to_depth,
                                         Number* sums) {
    const Number* const tag = nullptr;
    const auto c = [tag](float value) { return constant(value, tag); };
    const Number zero = c(0.0f), one = c(1.0f);
    const Number signed_x = to_x * c(softness.sharpness);
    const Number to_square = select(at.inside, signed_x, zero - signed_x);
    // Back-propagates the gradient of the depth. The depth is 1 / q, where q is the sum over k of
    // max(lambda_k, 0) / (z_k * total), and `total` is the sum over k of max(lambda_k, 0).
    const Number to_inverse = (zero - to_depth) / (at.inverse_depth * at.inverse_depth);
    const Number to_each = to_inverse / at.total;
    Number to_lambda[3], mean = zero;
    for (int k = 0; k < 3; ++k) {
        const Number clamped = maximum(at.lambda[k], zero);
        sums[6 + k] = sums[6 + k] + to_each * clamped;
        const Number through_depth = to_each * (c(face.inverse_z[k]) - at.inverse_depth);
        to_lambda[k] = select(at.lambda[k] > zero, through_depth, zero);
        if (softness.barycentric) {
            const Number through_x = c(2.0f) * at.lambda[k] * to_square;
            to_lambda[k] = to_lambda[k] + select(at.nearest[k], through_x, zero);
        }
        mean = mean + to_lambda[k] * at.lambda[k];
    }
    const Number px = pixel_x - c(face.x), py = pixel_y - c(face.y);
    for (int k = 0; k < 3; ++k) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        const Number to_cross = (to_lambda[k] - mean) * c(face.inverse_area);
        sums[a] = sums[a] + to_cross * (c(face.v[b]) - py);
        sums[3 + a] = sums[3 + a] - to_cross * (c(face.u[b]) - px);
        sums[b] = sums[b] - to_cross * (c(face.v[a]) - py);
        sums[3 + b] = sums[3 + b] + to_cross * (c(face.u[a]) - px);
    }
    if (softness.barycentric) return;
    const Number grad_x = c(-2.0f) * to_square * at.off_x, grad_y = c(-2.0f) * to_square * at.off_y;
    for (int k = 0; k < 3; ++k) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        const Number begin = select(at.nearest[k], one - at.along, zero), end = select(at.nearest[k], at.along, zero);
        sums[a] = sums[a] + grad_x * begin;
        sums[3 + a] = sums[3 + a] + grad_y * begin;
        sums[b] = sums[b] + grad_x * end;
        sums[3 + b] = sums[3 + b] + grad_y * end;
    }
}

// Computes the gradients of a triangle's vertex positions and writes them to `out` (3, 3). `sums` are the gradients of
// the triangle's projected shape, summed over all pixels.
FOURD_HD static inline void project_backward(const Pinhole& camera, const Corners<float>& at,
                                             const ShapeGradient& sums, float* out) {
    float to_z[3];
    for (int k = 0; k < 3; ++k) to_z[k] = -sums.inverse_z[k] / (at.z[k] * at.z[k]);
    corners_backward(camera, at, sums.u, sums.v, to_z, out);
}

}  // namespace fourd::soft_triangles
