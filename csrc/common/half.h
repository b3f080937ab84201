// Converts between float32 and IEEE half-precision numbers, which are stored as 16-bit integers.
#pragma once

#include <cstdint>
#include <cstring>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd {

// Converts half precision to float32: shifts the exponent and the mantissa to their places in a float, then multiplies
// the float by 2^112, because the exponent biases differ by 112. The conversion is exact, also for subnormal numbers.
// Infinity and NaN become finite values with a magnitude of 65536 or more.
FOURD_HD FOURD_INLINE float from_half(std::uint16_t half) {
    const std::uint32_t shifted = static_cast<std::uint32_t>(half & 0x7fff) << 13;
    float magnitude;
    memcpy(&magnitude, &shifted, sizeof magnitude);
    magnitude *= 5.192296858534828e33f;  // 2^112
    std::uint32_t bits;
    memcpy(&bits, &magnitude, sizeof bits);
    bits |= static_cast<std::uint32_t>(half & 0x8000) << 16;
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

// Converts float32 to half precision. The result is rounded to the nearest value, and ties are rounded to even. Values
// beyond +-65504, the largest finite half, are clamped. NaN becomes an arbitrary number.
FOURD_HD FOURD_INLINE std::uint16_t to_half(float value) {
    std::uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    const std::uint32_t sign = bits >> 16 & 0x8000u;
    std::uint32_t magnitude = bits & 0x7fffffffu;
    magnitude = magnitude < 0x477fe000u ? magnitude : 0x477fe000u;  // 65504
    const std::uint32_t normal = (magnitude + 0xfffu + (magnitude >> 13 & 1u) - (112u << 23)) >> 13;
    // For a subnormal result: float32 numbers in [0.5, 1) are 2^-24 apart, and so are the subnormal half-precision
    // numbers. Adding 0.5 to the value therefore rounds it to half precision, and the lowest bits of the sum are the
    // bits of the half-precision number.
    float small;
    memcpy(&small, &magnitude, sizeof small);
    small += 0.5f;
    std::uint32_t small_bits;
    memcpy(&small_bits, &small, sizeof small_bits);
    const std::uint32_t subnormal = small_bits - (126u << 23);
    return static_cast<std::uint16_t>(sign | (magnitude < 113u << 23 ? subnormal : normal));
}

}  // namespace fourd
