// The maths of the point renderer, shared by every backend. The order of operations must not change.
// fourd/rendering/ops/points/reference.py computes the same float32 numbers in the same order, so that kernel and reference find
// exactly the same hits.
//
// All functions are static, because they are compiled once per instruction set. Without `static`, the linker could put
// the AVX-512 version of a function into code for processors without AVX-512.
#pragma once

#include <cmath>
#include <cstdint>

#include "common/host_device.h"
#include "tiles/geometry.h"

namespace fourd::points {

using tiles::kBlock;
using tiles::kLongestSide;
using tiles::kTile;
using tiles::Pinhole;
using tiles::pixel_centre;
using tiles::tile_count;
using tiles::TileRange;
using tiles::tiles_across;

// A projected point. The alpha of the point at a pixel is density * (1 - |(u, v) - pixel|^2 * inverse_square).
struct alignas(16) Splat {
    float u, v;            // Projected centre in pixels.
    float inverse_square;  // Equal to 1 / rho^2.
    float density;         // At most 1.
    float z;               // Camera depth.
    float rho;             // Projected radius in pixels.
    std::uint16_t left, right, top, bottom;  // Inclusive range of blocks (4 x 4 pixels) that the point may hit.
};

FOURD_HD static inline TileRange tile_range_of(const Splat& splat) {
    constexpr int blocks = kTile / kBlock;
    return {static_cast<std::uint16_t>(splat.left / blocks), static_cast<std::uint16_t>(splat.right / blocks),
            static_cast<std::uint16_t>(splat.top / blocks), static_cast<std::uint16_t>(splat.bottom / blocks)};
}

// Sums of gradients over the pixels that a point hits. Let g be the gradient of the loss with respect to the point's
// alpha at a pixel. The members dx, dy, square and falloff are the sums over pixels of g times the member of
// PixelCoverage with the same name. The member z is the sum of the gradients with respect to the point's camera depth.
struct SplatGradient {
    float dx, dy, square, falloff, z;
};

// Computes the range, along one axis, of the pixels whose centres are within rho of `centre`. The range is clipped to
// [0, size), and is empty if first > last. The bounds are clipped before they are rounded, because the code then needs
// no branches, and compilers can vectorise it.
FOURD_HD static inline void pixel_range(float centre, float rho, int size, int* first, int* last) {
    // The hit test has a float32 rounding error of about 4e-7 * rho^2 in the squared distance, so the range uses a rho
    // that is larger by a factor of 1 + 1e-6 to contain all hits.
    const double extent = static_cast<double>(rho) * (1.0 + 1e-6);
    double low = static_cast<double>(centre) - extent - 0.5, high = static_cast<double>(centre) + extent - 0.5;
    low = low > 0.0 ? low : 0.0;
    low = low < size ? low : size;
    high = high < size - 1 ? high : size - 1;
    high = high > -1.0 ? high : -1.0;
    const int from = static_cast<int>(low), to = static_cast<int>(high);  // The conversion to int rounds towards 0.
    *first = from + (from < low ? 1 : 0);
    *last = to - (to > high ? 1 : 0);
}

// How a point covers a pixel. (dx, dy) is the vector from the pixel to the point's centre, in pixels, and `square` is
// its squared length. `falloff` is 1 - square * inverse_square, and alpha is density * falloff. The point hits the
// pixel if alpha is above 0.
struct PixelCoverage {
    float dx, dy, square, falloff, alpha;
};

FOURD_HD static inline PixelCoverage pixel_coverage(const Splat& splat, float x, float y) {
    const float dx = splat.u - x, dy = splat.v - y;
    const float square = dx * dx + dy * dy;
    const float falloff = 1.0f - square * splat.inverse_square;
    return {dx, dy, square, falloff, splat.density * falloff};
}

// A point after projection. If `visible` is false, the other members are undefined.
struct Projection {
    float u, v, inverse_square, density, z, rho;
    int left, right, top, bottom;
    bool visible;
};

// Projects a point. The point is culled if it is nearer than near_depth or outside the image, if its radius or density
// is not positive, or if any of its numbers is not finite. NaN is culled because all comparisons with NaN in the
// visibility test are false.
FOURD_HD static inline Projection project(const Pinhole& camera, float near_depth, const float* xyz, float radius,
                                          float density) {
    const float max_float = 3.402823466e38f;
    const float* r = camera.rotation;
    const float* k = camera.intrinsics;
    const float x = r[0] * xyz[0] + r[1] * xyz[1] + r[2] * xyz[2] + camera.translation[0];
    const float y = r[3] * xyz[0] + r[4] * xyz[1] + r[5] * xyz[2] + camera.translation[1];
    const float z = r[6] * xyz[0] + r[7] * xyz[1] + r[8] * xyz[2] + camera.translation[2];
    Projection out;
    out.u = (k[0] * x + k[1] * y) / z + k[2];
    out.v = (k[3] * x + k[4] * y) / z + k[5];
    out.rho = k[4] * radius / z;
    out.inverse_square = 1.0f / (out.rho * out.rho);
    out.density = density < 1.0f ? density : 1.0f;
    out.z = z;
    int first_column, last_column, first_row, last_row;
    pixel_range(out.u, out.rho, camera.width, &first_column, &last_column);
    pixel_range(out.v, out.rho, camera.height, &first_row, &last_row);
    out.left = first_column / kBlock;
    out.right = last_column / kBlock;
    out.top = first_row / kBlock;
    out.bottom = last_row / kBlock;
    // The conditions are joined by & instead of &&, to avoid branches.
    out.visible = (z >= near_depth) & (z <= max_float) & (radius > 0.0f) & (radius <= max_float) & (density > 0.0f) &
                  (density <= max_float) & (out.u >= -max_float) & (out.u <= max_float) & (out.v >= -max_float) &
                  (out.v <= max_float) & (out.inverse_square > 0.0f) & (out.inverse_square <= max_float) &
                  (first_column <= last_column) & (first_row <= last_row);
    return out;
}

// Builds the splat of a visible point.
FOURD_HD static inline Splat splat_of(const Projection& at) {
    return {at.u,
            at.v,
            at.inverse_square,
            at.density,
            at.z,
            at.rho,
            static_cast<std::uint16_t>(at.left),
            static_cast<std::uint16_t>(at.right),
            static_cast<std::uint16_t>(at.top),
            static_cast<std::uint16_t>(at.bottom)};
}

// Computes the gradient of a point from `sums`, the gradient of its splat.
FOURD_HD static inline void project_backward(const Pinhole& camera, const Splat& splat, const SplatGradient& sums,
                                             float density, float* grad_xyz, float* grad_radius, float* grad_density) {
    const float* r = camera.rotation;
    const float* k = camera.intrinsics;
    const float scale = -2.0f * splat.density * splat.inverse_square;
    const float grad_u = scale * sums.dx / splat.z;
    const float grad_v = scale * sums.dy / splat.z;
    const float grad_rho = -scale * sums.square / splat.rho / splat.z;
    const float x = k[0] * grad_u + k[3] * grad_v;
    const float y = k[1] * grad_u + k[4] * grad_v;
    const float z = sums.z - grad_u * (splat.u - k[2]) - grad_v * (splat.v - k[5]) - grad_rho * splat.rho;
    grad_xyz[0] = r[0] * x + r[3] * y + r[6] * z;
    grad_xyz[1] = r[1] * x + r[4] * y + r[7] * z;
    grad_xyz[2] = r[2] * x + r[5] * y + r[8] * z;
    *grad_radius = grad_rho * k[4];
    *grad_density = density <= 1.0f ? sums.falloff : 0.0f;
}

}  // namespace fourd::points
