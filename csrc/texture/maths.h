// Mip levels and bilinear weights of one texture lookup, shared by every backend. cube.h has the geometry of cube maps.
//
// The centre of texel i is at the coordinate (i + 0.5) / size.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::texture {

enum class Filter { nearest, linear, linear_mipmap_nearest, linear_mipmap_linear };
enum class Boundary { wrap, clamp, zero, cube };

FOURD_HD FOURD_INLINE bool uses_mips(Filter filter) {
    return filter == Filter::linear_mipmap_nearest || filter == Filter::linear_mipmap_linear;
}

FOURD_HD FOURD_INLINE float absolute(float x) { return x < 0.0f ? -x : x; }

FOURD_HD FOURD_INLINE bool is_finite(float x) { return absolute(x) <= 3.4028234e38f; }  // False for NaN.

// Rounds x down to an integer, for |x| < 2^31.
FOURD_HD FOURD_INLINE int floor_of(float x) {
    const int towards_zero = static_cast<int>(x);
    return towards_zero - (static_cast<float>(towards_zero) > x ? 1 : 0);
}

// Returns the base-2 logarithm of a positive normal number, accurate to a few units in the last place. Compilers can
// vectorise this function, but not std::log2.
FOURD_HD FOURD_INLINE float log2_of(float x) {
    constexpr std::uint32_t kSqrtHalf = 0x3f3504f3u;  // The bits of sqrt(0.5).
    std::uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    const std::int32_t exponent = static_cast<std::int32_t>(bits - kSqrtHalf) >> 23;
    bits -= static_cast<std::uint32_t>(exponent) << 23;
    float mantissa;  // In [sqrt(0.5), sqrt(2)).
    memcpy(&mantissa, &bits, sizeof mantissa);
    const float z = (mantissa - 1.0f) / (mantissa + 1.0f), z2 = z * z;
    // 2 atanh(z) / ln(2), as a series.
    const float series = ((0.3205989f * z2 + 0.41219859f) * z2 + 0.57707802f) * z2 + 0.96179669f;
    return static_cast<float>(exponent) + z * (series * z2 + 2.8853901f);
}

// Derivatives of the texture position (s, t) with respect to the pixel position (x, y) in the output picture, in texels
// of level 0 per pixel.
struct Footprint {
    float s_x, s_y, t_x, t_y;
};

// Derivatives are clamped to +-kMaxDerivative, so that their fourth powers are finite. NaN stays NaN.
constexpr float kMaxDerivative = 1e9f;
// A footprint counts as a point if its LongerAxis::square is below kMinSquare.
constexpr float kMinSquare = 1e-36f;

FOURD_HD FOURD_INLINE float limited_derivative(float value) {
    value = value > kMaxDerivative ? kMaxDerivative : value;
    return value < -kMaxDerivative ? -kMaxDerivative : value;
}

// The longer axis of a footprint. A footprint maps a circle with a radius of one pixel to an ellipse in the texture.
// With the Jacobian matrix J = (s_x, s_y; t_x, t_y), the symmetric matrix (a, c; c, b) is J^T J. Its larger eigenvalue
// `square` is the squared length of the ellipse's longer semi-axis, called the longer axis below. `root` is half the
// difference of the two eigenvalues.
struct LongerAxis {
    float a, b, c, root, square;
};

FOURD_HD FOURD_INLINE float square_root(float x) {
#ifdef __CUDA_ARCH__
    return sqrtf(x);
#elif defined(__GNUC__)
    return __builtin_sqrtf(x);
#else
    return std::sqrt(x);
#endif
}

FOURD_HD FOURD_INLINE LongerAxis longer_axis(const Footprint& d) {
    LongerAxis out;
    out.a = d.s_x * d.s_x + d.t_x * d.t_x;
    out.b = d.s_y * d.s_y + d.t_y * d.t_y;
    out.c = d.s_x * d.s_y + d.t_x * d.t_y;
    const float half = 0.5f * (out.a - out.b);
    out.root = square_root(half * half + out.c * out.c);
    out.square = 0.5f * (out.a + out.b) + out.root;
    return out;
}

// Returns the mip level of a footprint before the bias is added: the base-2 logarithm of the length of the longer axis,
// 0.5 * log2(square). A footprint that is a point gives a very negative level, and NaN gives NaN.
FOURD_HD FOURD_INLINE float level_of(const Footprint& d) {
    const float square = longer_axis(d).square;
    const float level = square < kMinSquare ? -1e30f : 0.5f * log2_of(square);
    return square == square ? level : square;
}

// Returns the derivatives of level_of() with respect to the four members of a footprint, or 0 if the footprint is a
// point.
FOURD_HD FOURD_INLINE Footprint level_slopes(const Footprint& d) {
    const LongerAxis axis = longer_axis(d);
    const bool is_point = !(axis.square >= kMinSquare);
    const float factor = is_point ? 0.0f : 0.72134752f / axis.square;  // 0.5 / (ln(2) * square)
    const float inverse = axis.root > 0.0f ? 1.0f / axis.root : 0.0f;
    const float skew = 0.25f * (axis.a - axis.b) * inverse;
    const float by_a = factor * (0.5f + skew), by_b = factor * (0.5f - skew), by_c = factor * (axis.c * inverse);
    return {2.0f * by_a * d.s_x + by_c * d.s_y, 2.0f * by_b * d.s_y + by_c * d.s_x,
            2.0f * by_a * d.t_x + by_c * d.t_y, 2.0f * by_b * d.t_y + by_c * d.t_x};
}

// Returns the mip level clamped to the existing levels. NaN counts as level 0.
FOURD_HD FOURD_INLINE float clamped_level(float level, int level_count) {
    const float last = static_cast<float>(level_count - 1);
    level = level > 0.0f ? level : 0.0f;
    return level < last ? level : last;
}

// The two levels that a lookup blends: the clamped level rounded down, and the next coarser level. Filters other than
// linear_mipmap_linear use only `low`.
struct Levels {
    int low, high;
    float fraction;  // Weight of `high`.
    bool is_between;  // False if the mip level has no gradient: it is clamped, or the filter does not blend levels.
};

FOURD_HD FOURD_INLINE Levels levels_at(float clamped, int level_count, Filter filter) {
    const float last = static_cast<float>(level_count - 1);
    const bool is_linear = filter == Filter::linear_mipmap_linear;
    const int low = static_cast<int>(clamped);
    const int next = low + 1 < level_count ? low + 1 : low;
    return {low, is_linear ? next : low, is_linear ? clamped - static_cast<float>(low) : 0.0f,
            is_linear && clamped > 0.0f && clamped < last};
}

// The two texels around a coordinate along one axis.
struct Axis {
    int index[2];
    float weight[2];
    float slope[2];  // Derivatives of the weights with respect to the coordinate.
};

FOURD_HD FOURD_INLINE float clamp_to(float x, float low, float high) {
    x = x > low ? x : low;
    return x < high ? x : high;
}

// Converts a finite coordinate for linear_axis and nearest_axis. With Boundary::wrap, the result is the fractional part
// of u, in [0, 1]. If |u| is at least 2^23, the fractional part is 0, because every such float is an integer. In all
// other boundary modes, the result is u.
template <Boundary boundary>
FOURD_HD FOURD_INLINE float wrapped(float u) {
    if (boundary != Boundary::wrap) return u;
    const float at = clamp_to(u, -8388608.0f, 8388608.0f);
    return at - static_cast<float>(floor_of(at));
}

FOURD_HD FOURD_INLINE int clamp_index(int i, int size) {
    i = i > 0 ? i : 0;
    return i < size ? i : size - 1;
}

// Returns the texels of a bilinear lookup along one axis. The coordinate comes from wrapped(). For Boundary::cube, an
// index of -1 or `size` stands for a texel of a neighbouring face.
template <Boundary boundary>
FOURD_HD FOURD_INLINE Axis linear_axis(float u, int size) {
    const float scale = static_cast<float>(size);
    if (boundary == Boundary::clamp) {
        const float x = u * scale - 0.5f, at = clamp_to(x, 0.0f, scale - 1.0f);
        const int low = static_cast<int>(at);
        const float fraction = at - static_cast<float>(low), slope = x == at ? scale : 0.0f;
        return {{low, clamp_index(low + 1, size)}, {1.0f - fraction, fraction}, {-slope, slope}};
    }
    const float wanted = u * scale - 0.5f;
    const float x = boundary == Boundary::wrap ? wanted : clamp_to(wanted, -1.0f, scale);
    const int low = floor_of(x), high = low + 1;
    const float fraction = x - static_cast<float>(low);
    if (boundary == Boundary::zero) {
        const float in_low = low >= 0 && low < size ? 1.0f : 0.0f, in_high = high >= 0 && high < size ? 1.0f : 0.0f;
        const float slope = wanted == x ? scale : 0.0f;
        return {{clamp_index(low, size), clamp_index(high, size)},
                {in_low * (1.0f - fraction), in_high * fraction},
                {-in_low * slope, in_high * slope}};
    }
    const Axis out = {{low, high}, {1.0f - fraction, fraction}, {-scale, scale}};
    if (boundary == Boundary::cube) return out;
    // The conditions are computed with bit masks, because compilers would turn ?: expressions into branches, which
    // prevent vectorisation.
    return {{low + (size & (low >> 31)), high - (size & ((size - 1 - high) >> 31))},
            {out.weight[0], out.weight[1]},
            {out.slope[0], out.slope[1]}};
}

// Returns the texels of a nearest lookup along one axis. The coordinate comes from wrapped(). The second texel has the
// weight 0.
template <Boundary boundary>
FOURD_HD FOURD_INLINE Axis nearest_axis(float u, int size) {
    const float scale = static_cast<float>(size);
    const float x = u * scale;
    const int index = static_cast<int>(clamp_to(x, 0.0f, scale - 1.0f));
    const bool is_inside = boundary != Boundary::zero || (x >= 0.0f && x < scale);
    return {{index, index}, {is_inside ? 1.0f : 0.0f, 0.0f}, {0.0f, 0.0f}};
}

template <Boundary boundary, bool is_nearest>
FOURD_HD FOURD_INLINE Axis axis_at(float u, int size) {
    return is_nearest ? nearest_axis<boundary>(u, size) : linear_axis<boundary>(u, size);
}

// The four texels of a lookup in one level: top left, top right, bottom left and bottom right.
struct Texels {
    int index[4];       // Index of the texel in its level, always inside the level.
    float weight[4];    // A texel outside the texture has the weight 0.
    float along_s[4];  // Derivatives of the weights with respect to the horizontal coordinate.
    float along_t[4];  // Derivatives of the weights with respect to the vertical coordinate.
};

// Combines the texels along two independent axes. `first` is the index of the first texel of the image or cube face.
// All weights are multiplied by `is_used`, which is 0 for a position that is not finite, and 1 for all other positions.
FOURD_HD FOURD_INLINE Texels texels_of(const Axis& s, const Axis& t, int first, int width, float is_used) {
    Texels out;
    for (int k = 0; k < 4; ++k) {
        const int column = k % 2, row = k / 2;
        out.index[k] = first + t.index[row] * width + s.index[column];
        out.weight[k] = s.weight[column] * (is_used * t.weight[row]);
        out.along_s[k] = s.slope[column] * (is_used * t.weight[row]);
        out.along_t[k] = s.weight[column] * (is_used * t.slope[row]);
    }
    return out;
}

}  // namespace fourd::texture
