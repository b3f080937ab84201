// Converts IEEE half-precision numbers, which are stored as 16-bit integers.
#pragma once

#include <cstdint>
#include <cstring>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd {

// Converts half precision to float32. The exponent and the mantissa are shifted into a float, which is then multiplied
// by 2^112, because the exponent biases differ by 112. The conversion is exact for subnormal numbers too. Infinity and
// NaN become finite values of 65536 or more.
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

}  // namespace fourd
