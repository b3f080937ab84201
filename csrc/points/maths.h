// The point renderer's maths, the same for every backend. The order of operations is a contract:
// fourd/ops/points/reference.py computes the same float32 numbers, so that both agree on every hit.
//
// Everything here is static: these functions are compiled once per instruction set, and the
// linker must not merge a version that needs AVX-512 into code that runs everywhere.
#pragma once

#include <cmath>
#include <cstdint>

#include "common/host_device.h"

namespace fourd::points {

// A pinhole camera: x_camera = rotation * x_world + translation; pixels = intrinsics * x_camera / z.
struct Pinhole {
    float intrinsics[9];
    float rotation[9];
    float translation[3];
    int width;
    int height;
};

constexpr int kTile = 16;               // pixels across and down that are composited together
constexpr int kBlock = 4;               // a tile is made of blocks of 4 x 4 pixels
constexpr int kLongestSide = 1 << 18;   // of an image, in pixels: blocks are counted in 16 bits

// A point as its pixels see it: alpha(pixel) = density * (1 - |(u, v) - pixel|^2 * inverse_square).
struct alignas(16) Splat {
    float u, v;            // projected centre, pixels
    float inverse_square;  // 1 / rho^2, rho the radius in pixels
    float density;         // at most 1
    float z;               // camera depth
    float rho;
    std::uint16_t left, right, top, bottom;  // blocks of kBlock x kBlock pixels that can hold a hit, within the image
};

// The tiles that a point reaches, the last ones included; none where right is left of left.
struct Reach {
    std::uint16_t left, right, top, bottom;
};

FOURD_HD static inline Reach reach_of(const Splat& splat) {
    constexpr int blocks = kTile / kBlock;
    return {static_cast<std::uint16_t>(splat.left / blocks), static_cast<std::uint16_t>(splat.right / blocks),
            static_cast<std::uint16_t>(splat.top / blocks), static_cast<std::uint16_t>(splat.bottom / blocks)};
}

FOURD_HD static inline std::uint64_t tiles_across(const Reach& reach) {
    return static_cast<std::uint64_t>(reach.right - reach.left + 1);
}

FOURD_HD static inline std::uint64_t tile_count(const Reach& reach) {
    return tiles_across(reach) * static_cast<std::uint64_t>(reach.bottom - reach.top + 1);
}

// Gradients of a point's pixels, summed: of alpha times (dx, dy, distance^2, falloff), and of depth.
struct SplatGradient {
    float dx, dy, square, falloff, z;
};

// The coordinate of a pixel's centre, whose index is exact in float32.
FOURD_HD static inline float pixel_centre(int index) { return static_cast<float>(index) + 0.5f; }

// The indices of the pixel centres within reach of centre, clipped to [0, size); empty if first > last. Numbers are clipped
// before they are rounded, so that nothing here branches and compilers make vectors of it.
FOURD_HD static inline void pixel_range(float centre, float rho, int size, int* first, int* last) {
    // A hit is decided in float32 to about 4e-7 of rho^2; the margin keeps this range a superset.
    const double reach = static_cast<double>(rho) * (1.0 + 1e-6);
    double low = static_cast<double>(centre) - reach - 0.5, high = static_cast<double>(centre) + reach - 0.5;
    low = low > 0.0 ? low : 0.0;
    low = low < size ? low : size;
    high = high < size - 1 ? high : size - 1;
    high = high > -1.0 ? high : -1.0;
    const int from = static_cast<int>(low), to = static_cast<int>(high);  // rounded towards 0
    *first = from + (from < low ? 1 : 0);
    *last = to - (to > high ? 1 : 0);
}

// A point as a pixel sees it; a hit where alpha is above 0.
struct PixelTouch {
    float dx, dy, square, falloff, alpha;
};

FOURD_HD static inline PixelTouch touch_pixel(const Splat& splat, float x, float y) {
    const float dx = splat.u - x, dy = splat.v - y;
    const float square = dx * dx + dy * dy;
    const float falloff = 1.0f - square * splat.inverse_square;
    return {dx, dy, square, falloff, splat.density * falloff};
}

// A point in the image, and whether it is to be seen there; the rest is of no use where it is not.
struct Projection {
    float u, v, inverse_square, density, z, rho;
    int left, right, top, bottom;
    bool visible;
};

// Projects a point. It is culled if it is nearer than near, outside the image, of no size or density, or has any
// number that is not finite. Guards are written so that NaN fails them.
FOURD_HD static inline Projection project(const Pinhole& camera, float near, const float* xyz, float radius,
                                          float density) {
    const float largest = 3.402823466e38f;
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
    // & and not &&: without branches.
    out.visible = (z >= near) & (z <= largest) & (radius > 0.0f) & (radius <= largest) & (density > 0.0f) &
                  (density <= largest) & (out.u >= -largest) & (out.u <= largest) & (out.v >= -largest) &
                  (out.v <= largest) & (out.inverse_square > 0.0f) & (out.inverse_square <= largest) &
                  (first_column <= last_column) & (first_row <= last_row);
    return out;
}

// What is kept of a visible point.
FOURD_HD static inline Splat splat_of(const Projection& at) {
    return {at.u, at.v, at.inverse_square, at.density, at.z, at.rho,
            static_cast<std::uint16_t>(at.left), static_cast<std::uint16_t>(at.right),
            static_cast<std::uint16_t>(at.top), static_cast<std::uint16_t>(at.bottom)};
}

// Carries a splat's gradient back to the point it was projected from.
FOURD_HD static inline void project_backward(const Pinhole& camera, const Splat& splat,
                                             const SplatGradient& sums, float density, float* grad_xyz,
                                             float* grad_radius, float* grad_density) {
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
