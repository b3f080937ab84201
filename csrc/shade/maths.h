// The maths of shading a point, shared by every backend.
#pragma once

#include <cmath>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::shade {

// Approximates tanh by the rational function that Eigen uses, with the same coefficients. The error is at most 4e-7.
// For large |x|, the result is -1 or 1.
FOURD_HD FOURD_INLINE float fast_tanh(float x) {
    constexpr float kLimit = 7.90531110763549805f;
    x = x < -kLimit ? -kLimit : x;
    x = x > kLimit ? kLimit : x;
    const float s = x * x;
    float p = -2.76076847742355e-16f;
    p = p * s + 2.00018790482477e-13f;
    p = p * s + -8.60467152213735e-11f;
    p = p * s + 5.12229709037114e-08f;
    p = p * s + 1.48572235717979e-05f;
    p = p * s + 6.37261928875436e-04f;
    p = p * s + 4.89352455891786e-03f;
    float q = 1.19825839466702e-06f;
    q = q * s + 1.18534705686654e-04f;
    q = q * s + 2.26843463243900e-03f;
    q = q * s + 4.89352518554385e-03f;
    return x * p / q;
}

// Calls `to(k, value)` for each of the 16 real spherical harmonics up to degree 3 in the direction (dx, dy, dz). The
// direction vector may have any length.
template <typename To>
FOURD_HD FOURD_INLINE void harmonics(float dx, float dy, float dz, const To& to) {
    const float square = dx * dx + dy * dy + dz * dz;
    const float scale = 1.0f / std::sqrt(square > 1e-24f ? square : 1e-24f);
    const float x = dx * scale, y = dy * scale, z = dz * scale;
    const float xx = x * x, yy = y * y, zz = z * z;
    to(0, 0.28209479177387814f);
    to(1, -0.4886025119029199f * y);
    to(2, 0.4886025119029199f * z);
    to(3, -0.4886025119029199f * x);
    to(4, 1.0925484305920792f * x * y);
    to(5, -1.0925484305920792f * y * z);
    to(6, 0.31539156525252005f * (2 * zz - xx - yy));
    to(7, -1.0925484305920792f * x * z);
    to(8, 0.5462742152960396f * (xx - yy));
    to(9, -0.5900435899266435f * y * (3 * xx - yy));
    to(10, 2.890611442640554f * x * y * z);
    to(11, -0.4570457994644658f * y * (4 * zz - xx - yy));
    to(12, 0.3731763325901154f * z * (2 * zz - 3 * xx - 3 * yy));
    to(13, -0.4570457994644658f * x * (4 * zz - xx - yy));
    to(14, 1.445305721320277f * z * (xx - yy));
    to(15, -0.5900435899266435f * x * (xx - 3 * yy));
}

}  // namespace fourd::shade
