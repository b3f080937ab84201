// IEEE half-precision numbers as they are stored: sixteen bits.
#pragma once

#include <cstdint>
#include <cstring>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd {

// By moving bits: the exponents differ by 112, and the multiplication by 2^112 puts subnormals right
// as well. Infinity and NaN come out finite (65536 and above).
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
