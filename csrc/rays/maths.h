// The maths of ray tracing, shared by every backend. fourd/rendering/ops/rays/reference.py computes the same float32 numbers in
// the same order.
//
// A triangle is hit if the watertight test of Woop, Benthin and Wald (2013, Watertight Ray/Triangle Intersection)
// accepts it, and if the ray meets its bounding box, enlarged by a padding (kPadding). The t of a hit is clamped to the
// interval in which the ray is inside this box. All operations of the box test are monotonic, even with rounding, so
// the interval of t in a box always contains the interval in any smaller box inside it. A traversal that skips the
// boxes that the ray misses therefore loses no hit.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::rays {

// The coordinates of vertices, origins and directions must be in [-kMaxMagnitude, kMaxMagnitude]. The largest absolute
// value of a direction's coordinates must be at least kMinDirection.
constexpr float kMaxMagnitude = 1e18f;
constexpr float kMinDirection = 1e-18f;
// Padding of boxes, as a multiple of the largest absolute coordinate of the ray's origin and the mesh. The rounding
// errors of the watertight test are at most a quarter of the padding.
constexpr float kPadding = 0x1p-21f;
// Smallest absolute coordinate of a scaled direction (Ray) in box tests. A smaller coordinate is replaced by kMinShare
// or -kMinShare, so that its reciprocal, and products with the reciprocal, stay finite.
constexpr float kMinShare = 1e-18f;
constexpr float kTiny = 1.17549435e-38f;  // The smallest normal number.
constexpr float kMaxFloat = 3.402823466e38f;
constexpr float kInfinity = __builtin_huge_valf();

// A ray, prepared for intersection. The direction is multiplied by the power of two `scale`, so that the largest
// absolute coordinate of the scaled direction is between 1 and 2. The point at the parameter t along the original
// direction has the parameter t' = t / scale along the scaled direction.
struct Ray {
    float origin[3];
    int x, y, z;        // A permutation of the axes. The direction has its largest absolute coordinate along axis z.
    float shear_x, shear_y, shear_z;
    float inverse[3];   // Reciprocals of the coordinates of the scaled direction.
    // The ray meets the plane in which coordinate i equals p at t' = (p - origin[i]) * inverse[i]. With a padding `pad`
    // on both sides, the plane becomes a slab. The ray enters the slab at t' = p * inverse[i] - enter[i] and leaves it
    // at t' = p * inverse[i] - leave[i], where
    //     enter[i] = origin[i] * inverse[i] + pad * |inverse[i]|,
    //     leave[i] = origin[i] * inverse[i] - pad * |inverse[i]|.
    float enter[3], leave[3];
    float scale, inverse_scale;
    float t_min, t_max;
};

FOURD_HD FOURD_INLINE float absolute(float a) { return a < 0.0f ? -a : a; }

// Returns 2^-e for a positive normal float a = m * 2^e with 1 <= m < 2.
FOURD_HD FOURD_INLINE float inverse_power_of(float a) {
    std::uint32_t bits;
    std::memcpy(&bits, &a, sizeof bits);
    bits = (254u << 23) - (bits & 0x7f800000u);
    float out;
    std::memcpy(&out, &bits, sizeof out);
    return out;
}

// Prepares a ray. Returns false if the ray cannot hit anything. The result is also false if an argument is NaN,
// because all comparisons with NaN are false.
FOURD_HD FOURD_INLINE bool prepare(const float* origin, const float* direction, float t_min, float t_max,
                                   float magnitude, Ray* out) {
    float largest = 0.0f, farthest = magnitude;
    int z = 0;
    for (int i = 0; i < 3; ++i) {
        const float size = absolute(direction[i]), away = absolute(origin[i]);
        if (!(size <= kMaxMagnitude) || !(away <= kMaxMagnitude)) return false;
        if (size > largest) largest = size, z = i;
        if (away > farthest) farthest = away;
    }
    if (!(largest >= kMinDirection) || !(t_min <= t_max)) return false;
    out->scale = inverse_power_of(largest);
    out->inverse_scale = 1.0f / out->scale;
    out->t_min = t_min;
    out->t_max = t_max;
    float scaled[3];
    const float pad = kPadding * farthest;
    for (int i = 0; i < 3; ++i) {
        out->origin[i] = origin[i];
        scaled[i] = direction[i] * out->scale;
        const float at_least = scaled[i] < 0.0f ? (scaled[i] > -kMinShare ? -kMinShare : scaled[i])
                                                : (scaled[i] < kMinShare ? kMinShare : scaled[i]);
        out->inverse[i] = 1.0f / at_least;
        const float centre = origin[i] * out->inverse[i], width = pad * absolute(out->inverse[i]);
        out->enter[i] = centre + width;
        out->leave[i] = centre - width;
    }
    out->z = z;
    out->x = (z + 1) % 3;
    out->y = (z + 2) % 3;
    if (scaled[z] < 0.0f) {
        const int x = out->x;
        out->x = out->y;
        out->y = x;
    }
    out->shear_z = 1.0f / scaled[z];
    out->shear_x = scaled[out->x] / scaled[z];
    out->shear_y = scaled[out->y] / scaled[z];
    return true;
}

// first_of() converts the lower limit t_min to t', and last_of() converts an upper limit t to t'. Both functions
// enlarge the interval slightly, because the conversion of a tiny t is rounded.
FOURD_HD FOURD_INLINE float first_of(const Ray& ray) {
    return ray.t_min * ray.inverse_scale - kTiny * ray.inverse_scale;
}

FOURD_HD FOURD_INLINE float last_of(const Ray& ray, float t) {
    return t * ray.inverse_scale + kTiny * ray.inverse_scale;
}

// Returns true if the hit (t, triangle) comes after the hit (other_t, other). Hits are ordered by t, then by triangle
// index.
FOURD_HD FOURD_INLINE bool is_after(float t, std::int32_t triangle, float other_t, std::int32_t other) {
    return t > other_t || (t == other_t && triangle > other);
}

struct Hit {
    float t, u, v;
    std::int32_t triangle;
};

// The barycentric weights of the corners, not normalised. If a weight is 0 in float, all three weights are computed
// again in double. In double, the products of floats are exact, so two triangles with a common edge agree on which side
// of the edge the ray passes.
struct Weights {
    float a, b, c;
};

FOURD_HD FOURD_INLINE Weights weights_of(const float ax, const float ay, const float bx, const float by, const float cx,
                                         const float cy) {
    Weights out = {cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax};
    if (out.a == 0.0f || out.b == 0.0f || out.c == 0.0f) {
        out.a = static_cast<float>(static_cast<double>(cx) * by - static_cast<double>(cy) * bx);
        out.b = static_cast<float>(static_cast<double>(ax) * cy - static_cast<double>(ay) * cx);
        out.c = static_cast<float>(static_cast<double>(bx) * ay - static_cast<double>(by) * ax);
    }
    return out;
}

// Computes the interval of t' in which the ray is inside the padded box of a triangle.
FOURD_HD FOURD_INLINE void box_interval(const Ray& ray, const float* a, const float* b, const float* c, float* first,
                                        float* last) {
    *first = -kMaxFloat;
    *last = kMaxFloat;
    for (int i = 0; i < 3; ++i) {
        const float rest_low = b[i] < c[i] ? b[i] : c[i], rest_high = b[i] > c[i] ? b[i] : c[i];
        const float low = a[i] < rest_low ? a[i] : rest_low, high = a[i] > rest_high ? a[i] : rest_high;
        const float near = ray.inverse[i] < 0.0f ? high : low, far = ray.inverse[i] < 0.0f ? low : high;
        const float enter = near * ray.inverse[i] - ray.enter[i], leave = far * ray.inverse[i] - ray.leave[i];
        if (enter > *first) *first = enter;
        if (leave < *last) *last = leave;
    }
}

// Intersects a ray with the triangle that has the corners a, b and c. Returns true if the triangle is hit with t in
// [t_min, t_max], and writes t, u and v. Rays hit a triangle from both sides, and also at its edges.
FOURD_HD FOURD_INLINE bool intersect(const Ray& ray, const float* a, const float* b, const float* c, Hit* out) {
    const float az = a[ray.z] - ray.origin[ray.z], bz = b[ray.z] - ray.origin[ray.z], cz = c[ray.z] - ray.origin[ray.z];
    const float ax = (a[ray.x] - ray.origin[ray.x]) - ray.shear_x * az;
    const float ay = (a[ray.y] - ray.origin[ray.y]) - ray.shear_y * az;
    const float bx = (b[ray.x] - ray.origin[ray.x]) - ray.shear_x * bz;
    const float by = (b[ray.y] - ray.origin[ray.y]) - ray.shear_y * bz;
    const float cx = (c[ray.x] - ray.origin[ray.x]) - ray.shear_x * cz;
    const float cy = (c[ray.y] - ray.origin[ray.y]) - ray.shear_y * cz;
    const Weights weights = weights_of(ax, ay, bx, by, cx, cy);
    const bool inside = (weights.a >= 0.0f && weights.b >= 0.0f && weights.c >= 0.0f) ||
                        (weights.a <= 0.0f && weights.b <= 0.0f && weights.c <= 0.0f);
    if (!inside) return false;
    const float sum = (weights.a + weights.b) + weights.c;
    if (sum == 0.0f) return false;
    const float depths = (weights.a * az + weights.b * bz) + weights.c * cz;
    float t = depths * ray.shear_z / sum, first, last;
    box_interval(ray, a, b, c, &first, &last);
    if (!(first <= last)) return false;
    t = t < first ? first : t > last ? last : t;
    out->t = t * ray.scale;
    out->u = weights.a / sum;
    out->v = weights.b / sum;
    return out->t >= ray.t_min && out->t <= ray.t_max;
}

// Computes y, the gradient of the loss with respect to the origin of the ray, by implicit differentiation. The hit
// solves
//     origin + t * direction = u * a + v * b + (1 - u - v) * c.
// Let to_t, to_u and to_v be the gradients with respect to t, u and v, and let M be the matrix with the columns
// -direction, a - c and b - c. The gradient with respect to the origin is
//     y = M^-T (to_t, to_u, to_v).
// The gradient with respect to the direction is t * y. The gradients with respect to the corners a, b and c are -u * y,
// -v * y and -(1 - u - v) * y. If the ray lies in the plane of the triangle, the function returns false and sets y to
// 0.
FOURD_HD FOURD_INLINE bool hit_gradient(const float* direction, const float* a, const float* b, const float* c,
                                        float to_t, float to_u, float to_v, float* y) {
    double d[3], p[3], q[3];
    for (int i = 0; i < 3; ++i) {
        d[i] = -static_cast<double>(direction[i]);
        p[i] = static_cast<double>(a[i]) - c[i];
        q[i] = static_cast<double>(b[i]) - c[i];
        y[i] = 0.0f;
    }
    const double pq[3] = {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]};
    const double qd[3] = {q[1] * d[2] - q[2] * d[1], q[2] * d[0] - q[0] * d[2], q[0] * d[1] - q[1] * d[0]};
    const double dp[3] = {d[1] * p[2] - d[2] * p[1], d[2] * p[0] - d[0] * p[2], d[0] * p[1] - d[1] * p[0]};
    const double determinant = d[0] * pq[0] + d[1] * pq[1] + d[2] * pq[2];
    if (determinant == 0.0) return false;
    for (int i = 0; i < 3; ++i) {
        y[i] = static_cast<float>((to_t * pq[i] + to_u * qd[i] + to_v * dp[i]) / determinant);
    }
    return true;
}

}  // namespace fourd::rays
