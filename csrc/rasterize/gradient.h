// The gradient of the rasterizer, shared by every backend. maths.h defines M, f and b.
//
// If the vertex p_k = (x, y, w)_k moves by dp_k, the vector b = M^-1 f changes by -b_k M^-1 dp_k. A gradient g with
// respect to b therefore becomes the gradient -b_k M^-T g with respect to p_k. M is the same at all pixels of a
// triangle, so only the products b_k g are summed over pixels. Let b_x be the derivative of b along x. A gradient g
// with respect to b_x adds -(b_x)_k M^-T g to the gradient with respect to p_k. The same holds for b_y, the derivative
// along y.
//
// The code replaces b_2 by the sum s = b_0 + b_1 + b_2 = 1/w. Below, g0, g1 and gs are the gradients with respect to
// b_0, b_1 and s. The struct Planes stores b_0, b_1 and s multiplied by a factor (Planes::scale). This divides the
// gradients by the same factor, so the products of gradients and values do not depend on it.
#pragma once

#include "rasterize/maths.h"

namespace fourd::rasterize {

constexpr int kSums = 15;
constexpr double kLargestGradient = 1e30;  // The gradients of degenerate triangles are clamped to +-1e30.

FOURD_HD static inline float bounded(double gradient) {
    gradient = gradient > -kLargestGradient ? gradient : -kLargestGradient;
    return static_cast<float>(gradient < kLargestGradient ? gradient : kLargestGradient);
}

// Computes the 15 values of one pixel that are later summed over the pixels of a triangle. The first 9 values are the
// products of each of the gradients g0, g1 and gs with each of the values b_0, b_1 and s (see the top of this file).
// The next 3 values are the gradients with respect to the slopes `x`, and the last 3 values are those with respect to
// the slopes `y`.
//
// The first three functions of Planes (maths.h) are b_0, b_1 and s times Planes::scale. `b` has their values at the
// pixel. `x` and `y` have the slopes of these functions, per pixel along x and along y. grad_u and grad_v are
// the gradients with respect to u and v in rast. `db` (4,) is the gradient with respect to rast_db.
template <bool kDerivatives>
FOURD_HD static inline void pixel_gradient(const float* b, const float* x, const float* y, float grad_u, float grad_v,
                                           const float* db, float* out) {
    const float s = b[2] > kSmallestInverseW ? b[2] : kSmallestInverseW, w = 1.0f / s;
    const float u_free = b[0] * w, v_free = b[1] * w;
    const Weights weights = weights_of(b[0], b[1], b[2], x, y);
    const float u = weights.u, v = weights.v;
    float grad_s = 0.0f;
    float grad_x[3] = {0.0f, 0.0f, 0.0f}, grad_y[3] = {0.0f, 0.0f, 0.0f};
    if (kDerivatives) {
        const float u_x = db[0] * w, u_y = db[1] * w, v_x = db[2] * w, v_y = db[3] * w;
        grad_u -= u_x * x[2] + u_y * y[2];
        grad_v -= v_x * x[2] + v_y * y[2];
        grad_s -= u_x * weights.u_x + u_y * weights.u_y + v_x * weights.v_x + v_y * weights.v_y;
        grad_x[0] = u_x, grad_x[1] = v_x, grad_x[2] = -(u_x * u + v_x * v);
        grad_y[0] = u_y, grad_y[1] = v_y, grad_y[2] = -(u_y * u + v_y * v);
    }
    // Back-propagates through the clamps of u and v. The upper limit of v is 1 - u.
    grad_u -= v_free > 1.0f - u ? grad_v : 0.0f;
    grad_v = v_free > 1.0f - u ? 0.0f : grad_v;
    grad_v = v_free < 0.0f ? 0.0f : grad_v;
    grad_u = u_free < 0.0f ? 0.0f : grad_u;
    grad_u = u_free > 1.0f ? 0.0f : grad_u;
    const float g[3] = {grad_u * w, grad_v * w, grad_s - (grad_u * u_free + grad_v * v_free) * w};
    for (int j = 0; j < 3; ++j) {
        out[3 * j] = g[j] * b[0];
        out[3 * j + 1] = g[j] * b[1];
        out[3 * j + 2] = g[j] * s;
        out[9 + j] = grad_x[j];
        out[12 + j] = grad_y[j];
    }
}

// Converts the sums over the pixels of a triangle to the gradients `out` (3, 4) with respect to x, y, z and w of its
// vertices. `c` has the values of the first three functions of Planes (maths.h), called planes below, and `x` and `y`
// have their slopes. `scale` is the scale of these planes, and (column, row) is their reference pixel.
FOURD_HD static inline void vertex_gradients(const Screen& screen, int column, int row, const float* c, const float* x,
                                             const float* y, double scale, const float* sums, float* out) {
    // The planes as functions of normalised device coordinates: slopes along x and y, and the value at the centre of
    // the image.
    const double half_width = 0.5 * screen.width, half_height = 0.5 * screen.height;
    const double from_x = device_coordinate(column, screen.width), from_y = device_coordinate(row, screen.height);
    double normal[3][3], b_x[3], b_y[3], product[3][3];
    for (int j = 0; j < 3; ++j) {
        b_x[j] = x[j];
        b_y[j] = y[j];
        normal[j][0] = b_x[j] * half_width;
        normal[j][1] = b_y[j] * half_height;
        normal[j][2] = c[j] - normal[j][0] * from_x - normal[j][1] * from_y;
        product[j][0] = sums[3 * j];
        product[j][1] = sums[3 * j + 1];
        product[j][2] = static_cast<double>(sums[3 * j + 2]) - sums[3 * j] - sums[3 * j + 1];
    }
    // The third plane is the sum over all three vertices, so subtracting the first two planes leaves the plane of
    // vertex 2.
    b_x[2] -= b_x[0] + b_x[1];
    b_y[2] -= b_y[0] + b_y[1];
    for (int k = 0; k < 3; ++k) {
        double gradient[3] = {0.0, 0.0, 0.0};
        for (int j = 0; j < 3; ++j) {
            const double factor = product[j][k] + b_x[k] * sums[9 + j] + b_y[k] * sums[12 + j];
            for (int axis = 0; axis < 3; ++axis) gradient[axis] -= factor * normal[j][axis];
        }
        out[4 * k] = bounded(gradient[0] / scale);
        out[4 * k + 1] = bounded(gradient[1] / scale);
        out[4 * k + 2] = 0.0f;
        out[4 * k + 3] = bounded(gradient[2] / scale);
    }
}

}  // namespace fourd::rasterize
