// The format in which all triangle kernels store triangle ids as pixel values of a float32 image. The value 0 is the
// background, and triangle i has the number n = i + 1. A number up to 2^24 is stored as a float of this value. Above
// 2^24, float32 cannot represent every integer, so n is stored as the float with the bits 0x4a800000 + n. The floats
// have the same order as the numbers over the whole range.
#pragma once

#include <cstdint>
#include <cstring>

#include "common/host_device.h"

namespace fourd {

constexpr int kNoTriangle = -1;
constexpr std::uint32_t kExactIds = 1u << 24;
constexpr std::uint32_t kIdBits = 0x4a800000u;
constexpr std::uint32_t kMaxTriangles = 0x7f800000u - kIdBits - 1;  // Ids above kMaxTriangles would be infinite or NaN.

// Returns the float that encodes the index `triangle` in a rasterized image. `triangle` may be kNoTriangle.
FOURD_HD static inline float value_of_triangle(int triangle) {
    const std::uint32_t number = static_cast<std::uint32_t>(triangle + 1);
    if (number <= kExactIds) return static_cast<float>(number);
    const std::uint32_t bits = kIdBits + number;
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

// Returns the triangle of a pixel value, or kNoTriangle. Values that are negative or NaN count as background.
FOURD_HD static inline int triangle_of_value(float value) {
    if (!(value >= 1.0f)) return kNoTriangle;
    if (value <= static_cast<float>(kExactIds)) return static_cast<int>(value) - 1;
    std::uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return static_cast<int>(bits - kIdBits) - 1;
}

}  // namespace fourd
