// The maths of the rasterizer, shared by every backend. The order of operations must not change.
// fourd/rendering/ops/rasterize/reference.py computes the same numbers in the same order, so that kernel and reference find
// exactly the same triangles.
//
// Coverage is computed with integers: vertices are rounded to 1/256 pixel, so edge functions have no rounding error. A
// pixel is covered if its centre is inside all three edges. If a centre lies on an edge, the triangle covers it only if
// the edge is a left or top edge of the triangle. A triangle with a vertex behind the camera or far outside the image
// is clipped first.
//
// The barycentric weights u and v of vertices 0 and 1, and z/w, are computed from the unclipped triangle (Olano and
// Greer 1997, Triangle Scan Conversion using 2D Homogeneous Coordinates). Let M be the matrix whose columns are the
// vertices (x, y, w), and let f = (f_x, f_y, 1), where (f_x, f_y) is a pixel centre in normalised device coordinates.
// The vector b = M^-1 f has the elements
//     b_k = (barycentric weight of vertex k) / w,
// where w is the interpolated w at the pixel centre. z/w is the sum of z_k b_k.
//
// All functions are static, so that each file keeps its own copy, compiled for the instruction set of that file.
#pragma once

#include <cstdint>

#include "common/host_device.h"
#include "common/triangle_id.h"

namespace fourd::rasterize {

constexpr int kSubpixelBits = 8;
constexpr int kSubpixels = 1 << kSubpixelBits;
constexpr int kHalfPixel = kSubpixels / 2;
// A triangle is degenerate, and is culled, if a coefficient of its Planes has an absolute value above
// kLargestCoefficient.
constexpr float kLargestCoefficient = 1e10f;
// Lower limit of scale / w (see Planes). Inside a triangle, scale / w is at least 1.
constexpr float kSmallestInverseW = 1e-6f;
constexpr float kLargestFloat = 3.402823466e38f;
constexpr int kPlanes = 4;  // Number of linear functions in the struct Planes.

struct Screen {
    int width, height;
    // Vertices with |x| > guard_x * w or |y| > guard_y * w are clipped. The guards are powers of two, so that the
    // comparison has no rounding error. The guards limit pixel coordinates to +-2^16 from the centre of the image.
    float guard_x, guard_y;
};

FOURD_HD static inline float guard_of(int side) {
    int guard = 4;
    while (2 * guard * side <= 1 << 17) guard *= 2;
    return static_cast<float>(guard);
}

FOURD_HD static inline Screen make_screen(int width, int height) {
    return {width, height, guard_of(width), guard_of(height)};
}

enum class VertexState : std::int32_t { inside, clipped, invalid };

// The position of a vertex in units of 1/256 pixel. The corner of the image at column 0 and row 0 is at (0, 0).
struct Snapped {
    std::int32_t x, y;
    VertexState state;
};

FOURD_HD static inline bool is_finite(float value) { return value >= -kLargestFloat && value <= kLargestFloat; }

FOURD_HD static inline float magnitude(float value) { return value < 0.0f ? -value : value; }

// Rounds to the nearest integer. Halves are rounded up. |value| must be below 2^31.
FOURD_HD static inline std::int32_t round_half_up(float value) {
    const std::int32_t whole = static_cast<std::int32_t>(value);
    const float rest = value - static_cast<float>(whole);
    return whole + (rest >= 0.5f ? 1 : 0) - (rest < -0.5f ? 1 : 0);
}

// Rounds a vertex to 1/256 pixel. Requires w > 0, |x| <= guard_x * w and |y| <= guard_y * w.
FOURD_HD static inline Snapped snap_inside(const Screen& screen, float x, float y, float w) {
    const float u = x / w, v = y / w;
    return {round_half_up(u * static_cast<float>(kHalfPixel * screen.width)) + kHalfPixel * screen.width,
            round_half_up(v * static_cast<float>(kHalfPixel * screen.height)) + kHalfPixel * screen.height,
            VertexState::inside};
}

FOURD_HD static inline Snapped snap(const Screen& screen, const float* pos) {
    const float x = pos[0], y = pos[1], w = pos[3];
    if (!(is_finite(x) && is_finite(y) && is_finite(pos[2]) && is_finite(w))) return {0, 0, VertexState::invalid};
    const bool inside = w > 0.0f && magnitude(x) <= screen.guard_x * w && magnitude(y) <= screen.guard_y * w;
    if (!inside) return {0, 0, VertexState::clipped};
    return snap_inside(screen, x, y, w);
}

// A triangle or a part of a clipped triangle, with positive area. Coordinates are in units of 1/256 pixel.
struct Piece {
    std::int32_t x[3], y[3];
    std::int32_t triangle;
    std::uint16_t reference_x, reference_y;  // Reference pixel of the triangle's Planes.
};

// An inclusive range of pixels. The range is empty if left > right or top > bottom.
struct Bounds {
    int left, right, top, bottom;

    FOURD_HD bool is_empty() const { return left > right || top > bottom; }
};

FOURD_HD static inline int smaller(int a, int b) { return a < b ? a : b; }
FOURD_HD static inline int larger(int a, int b) { return a > b ? a : b; }

// Positions along one axis are in units of 1/256 pixel. first_pixel() returns the first pixel whose centre is at or
// after a position, and last_pixel() returns the last pixel whose centre is at or before it.
FOURD_HD static inline int first_pixel(int position) { return (position + kHalfPixel - 1) >> kSubpixelBits; }
FOURD_HD static inline int last_pixel(int position) { return (position - kHalfPixel) >> kSubpixelBits; }

// Returns the range of the image pixels whose centres are inside a piece's bounding box.
FOURD_HD static inline Bounds bounds_of(const Screen& screen, const Piece& piece) {
    const int low_x = smaller(smaller(piece.x[0], piece.x[1]), piece.x[2]);
    const int high_x = larger(larger(piece.x[0], piece.x[1]), piece.x[2]);
    const int low_y = smaller(smaller(piece.y[0], piece.y[1]), piece.y[2]);
    const int high_y = larger(larger(piece.y[0], piece.y[1]), piece.y[2]);
    return {larger(first_pixel(low_x), 0), smaller(last_pixel(high_x), screen.width - 1), larger(first_pixel(low_y), 0),
            smaller(last_pixel(high_y), screen.height - 1)};
}

// Makes a piece from three corners. Two corners are swapped if the area would otherwise be negative. Returns false if
// the area is 0.
FOURD_HD static inline bool make_piece(const Snapped& a, const Snapped& b, const Snapped& c, int triangle,
                                       Piece* piece) {
    const std::int64_t area = std::int64_t{b.x - a.x} * (c.y - a.y) - std::int64_t{b.y - a.y} * (c.x - a.x);
    if (area == 0) return false;
    const bool swapped = area < 0;
    *piece = {{a.x, swapped ? c.x : b.x, swapped ? b.x : c.x}, {a.y, swapped ? c.y : b.y, swapped ? b.y : c.y},
              triangle, 0, 0};
    return true;
}

// An edge function of a triangle: its value at one pixel, and its slopes per pixel along x and y. A pixel is inside the
// edge if the value at the pixel is at least 0.
struct Edge {
    std::int64_t value;
    std::int32_t x, y;
};

// Returns the function of the edge from vertex k to the next vertex, with its value at the pixel (column, row). Values
// are divided by 256 and rounded down. Before the division, the values at any two pixels differ by a multiple of 256,
// so the slopes are still exact after the division. Rounding down does not change which values are negative.
FOURD_HD static inline Edge edge_of(const Piece& piece, int k, int column, int row) {
    const int next = k == 2 ? 0 : k + 1;
    const std::int32_t dx = piece.x[next] - piece.x[k], dy = piece.y[next] - piece.y[k];
    const std::int32_t slope_x = -dy, slope_y = dx;
    const bool includes_centres = slope_x > 0 || (slope_x == 0 && slope_y > 0);
    const std::int64_t from_x = std::int64_t{kSubpixels} * column + kHalfPixel - piece.x[k];
    const std::int64_t from_y = std::int64_t{kSubpixels} * row + kHalfPixel - piece.y[k];
    const std::int64_t value = slope_x * from_x + slope_y * from_y - (includes_centres ? 0 : 1);
    return {value >> kSubpixelBits, slope_x, slope_y};
}

// Returns the largest value of an edge function in a rectangle of `columns` x `rows` pixels. edge.value is the value at
// the first pixel of the rectangle.
FOURD_HD static inline std::int64_t largest_value(const Edge& edge, int columns, int rows) {
    return edge.value + std::int64_t{larger(edge.x, 0)} * (columns - 1) + std::int64_t{larger(edge.y, 0)} * (rows - 1);
}

// Returns the normalised device coordinate of a pixel's centre.
FOURD_HD static inline double device_coordinate(int pixel, int side) {
    return static_cast<double>(2 * pixel + 1) / static_cast<double>(side) - 1.0;
}

// Four linear functions over the image, in this order:
//     scale * u / w, scale * v / w, scale / w and z / w.
// Here u and v are the barycentric weights of vertices 0 and 1, and z and w are interpolated clip coordinates. `scale`
// is the largest |w| of the vertices, so scaling all clip coordinates by a common factor does not change the functions.
// The value of a function at a pixel is (c + y * dy) + x * dx. Here c is the value at the triangle's reference pixel
// (set_reference in clipping.h), x and y are the slopes, and (dx, dy) is the vector from the reference pixel to the
// pixel.
struct Planes {
    double scale;
    float c[kPlanes], x[kPlanes], y[kPlanes];
    // The range of z/w of the vertices, to which z/w is clamped. The rounded triangle can cover a pixel centre just
    // outside the exact triangle. Without the clamp, the depth at this centre would be arbitrary if the triangle is
    // seen edge-on.
    float low, high;
    bool is_valid;
};

FOURD_HD static inline void cross(const double* a, const double* b, double* out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

FOURD_HD static inline bool is_moderate(double value) {
    return value >= -kLargestCoefficient && value <= kLargestCoefficient;
}

// Computes the Planes of a triangle. p0, p1 and p2 are the clip coordinates x, y, z, w of its vertices.
FOURD_HD static inline Planes make_planes(const Screen& screen, const float* p0, const float* p1, const float* p2,
                                          int reference_x, int reference_y) {
    const double a[3] = {p0[0], p0[1], p0[3]}, b[3] = {p1[0], p1[1], p1[3]}, c[3] = {p2[0], p2[1], p2[3]};
    double n[3][3];
    cross(b, c, n[0]);
    cross(c, a, n[1]);
    cross(a, b, n[2]);
    const double w0 = a[2] < 0.0 ? -a[2] : a[2], w1 = b[2] < 0.0 ? -b[2] : b[2], w2 = c[2] < 0.0 ? -c[2] : c[2];
    const double w01 = w0 > w1 ? w0 : w1, scale = w01 > w2 ? w01 : w2;
    const double inverse = scale / (a[0] * n[0][0] + a[1] * n[0][1] + a[2] * n[0][2]);
    const double at_x = device_coordinate(reference_x, screen.width);
    const double at_y = device_coordinate(reference_y, screen.height);
    const double step_x = 2.0 / static_cast<double>(screen.width), step_y = 2.0 / static_cast<double>(screen.height);
    double value[3], slope_x[3], slope_y[3];
    for (int k = 0; k < 3; ++k) {
        value[k] = (n[k][0] * at_x + n[k][1] * at_y + n[k][2]) * inverse;
        slope_x[k] = n[k][0] * inverse * step_x;
        slope_y[k] = n[k][1] * inverse * step_y;
    }
    const double z[3] = {p0[2], p1[2], p2[2]};
    const double values[kPlanes] = {value[0], value[1], value[0] + value[1] + value[2],
                                    (z[0] * value[0] + z[1] * value[1] + z[2] * value[2]) / scale};
    const double slopes_x[kPlanes] = {slope_x[0], slope_x[1], slope_x[0] + slope_x[1] + slope_x[2],
                                      (z[0] * slope_x[0] + z[1] * slope_x[1] + z[2] * slope_x[2]) / scale};
    const double slopes_y[kPlanes] = {slope_y[0], slope_y[1], slope_y[0] + slope_y[1] + slope_y[2],
                                      (z[0] * slope_y[0] + z[1] * slope_y[1] + z[2] * slope_y[2]) / scale};
    Planes out;
    out.scale = scale;
    bool valid = true;
    for (int k = 0; k < kPlanes; ++k) {
        valid = valid & is_moderate(values[k]) & is_moderate(slopes_x[k]) & is_moderate(slopes_y[k]);
        out.c[k] = static_cast<float>(values[k]);
        out.x[k] = static_cast<float>(slopes_x[k]);
        out.y[k] = static_cast<float>(slopes_y[k]);
    }
    const float d0 = p0[2] / p0[3], d1 = p1[2] / p1[3], d2 = p2[2] / p2[3];
    const float low = d0 < d1 ? d0 : d1, high = d0 < d1 ? d1 : d0;
    const bool in_front = (p0[3] > 0.0f) & (p1[3] > 0.0f) & (p2[3] > 0.0f);
    out.low = in_front ? (low < d2 ? low : d2) : -kLargestFloat;
    out.high = in_front ? (high < d2 ? d2 : high) : kLargestFloat;
    out.is_valid = valid;
    return out;
}

FOURD_HD static inline float plane_at(float c, float x, float y, float dx, float dy) { return (c + y * dy) + x * dx; }

// Clamps a depth to [low, high]. Adding 0 turns -0 into 0, so that equal depths have equal bits.
FOURD_HD static inline float clamp_depth(float depth, float low, float high) {
    depth = depth < low ? low : depth;
    return (depth > high ? high : depth) + 0.0f;
}

// u, v and their derivatives per pixel along x and y.
struct Weights {
    float u, v, u_x, u_y, v_x, v_y;
};

// Computes u, v and their derivatives. w0, w1 and inverse_w are the values of the first three planes at a pixel, and x
// and y are the slopes of these planes.
FOURD_HD static inline Weights weights_of(float w0, float w1, float inverse_w, const float* x, const float* y) {
    inverse_w = inverse_w > kSmallestInverseW ? inverse_w : kSmallestInverseW;
    const float w = 1.0f / inverse_w;
    float u = w0 * w, v = w1 * w;
    u = u > 0.0f ? u : 0.0f;
    u = u < 1.0f ? u : 1.0f;
    v = v > 0.0f ? v : 0.0f;
    v = v < 1.0f - u ? v : 1.0f - u;
    return {u, v, (x[0] - u * x[2]) * w, (y[0] - u * y[2]) * w, (x[1] - v * x[2]) * w, (y[1] - v * y[2]) * w};
}

}  // namespace fourd::rasterize
