// The computations of a point that are no matrix products: spherical harmonics and their gradient.
#pragma once

#include <cstdint>
#include <cstring>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::heads {

// Approximates exp(x) for x in [-80, 80], with a relative error below 2e-7.
FOURD_HD FOURD_INLINE float fast_exp(float x) {
    x = x > -80.0f ? x : -80.0f;
    x = x < 80.0f ? x : 80.0f;
    const std::int32_t power = static_cast<std::int32_t>(x * 1.44269504f + (x < 0.0f ? -0.5f : 0.5f));
    const float whole = static_cast<float>(power);
    const float r = (x - whole * 0.693359375f) + whole * 2.12194440e-4f;
    float p = 1.9875691500e-4f;
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * r * r + r + 1.0f;
    const std::int32_t bits = (power + 127) << 23;
    float scale;
    std::memcpy(&scale, &bits, sizeof scale);
    return p * scale;
}

// Computes the gradient of a direction (x, y, z) from the gradients `q` of the SH functions.
// The functions are those of directional_terms() in fourd/rendering/ops/shade/harmonics.py.
FOURD_HD FOURD_INLINE void sh_basis_backward(float x, float y, float z, const float* q, float* gx, float* gy,
                                             float* gz) {
    const float xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
    constexpr float a = 0.4886025119029199f, b = 1.0925484305920792f, c = 0.31539156525252005f, d = 0.5462742152960396f;
    constexpr float e = 0.5900435899266435f, f = 2.890611442640554f, g = 0.4570457994644658f, h = 0.3731763325901154f;
    constexpr float k = 1.445305721320277f;
    const float q1 = q[1], q2 = q[2], q3 = q[3], q4 = q[4], q5 = q[5], q6 = q[6], q7 = q[7], q8 = q[8], q9 = q[9];
    const float q10 = q[10], q11 = q[11], q12 = q[12], q13 = q[13], q14 = q[14], q15 = q[15];
    *gx = -a * q3 + b * (y * q4 - z * q7) + 2 * x * (d * q8 - c * q6) + f * yz * q10 + xy * (2 * g * q11 - 6 * e * q9) +
          xz * (2 * k * q14 - 6 * h * q12) - g * (4 * zz - 3 * xx - yy) * q13 - 3 * e * (xx - yy) * q15;
    *gy = -a * q1 + b * (x * q4 - z * q5) - 2 * y * (d * q8 + c * q6) + f * xz * q10 +
          xy * (2 * g * q13 + 6 * e * q15) - yz * (2 * k * q14 + 6 * h * q12) - g * (4 * zz - xx - 3 * yy) * q11 -
          3 * e * (xx - yy) * q9;
    *gz = a * q2 - b * (y * q5 + x * q7) + 4 * c * z * q6 + f * xy * q10 - 8 * g * (yz * q11 + xz * q13) +
          3 * h * (2 * zz - xx - yy) * q12 + k * (xx - yy) * q14;
}

}  // namespace fourd::heads
