// The arithmetic of the pixel filter, which CPU and GPU share.
#pragma once

#include <cstdint>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::pixel_filter {

// Returns the mean of three neighbouring values with the weights side, 1 - 2 * side and side. For three equal values,
// the result is exactly that value.
FOURD_HD FOURD_INLINE float mean_of(float before, float centre, float after, float side) {
    return centre + side * ((before - centre) + (after - centre));
}

// Rounds a number in [0, 255] to the nearest integer.
FOURD_HD FOURD_INLINE std::uint8_t to_byte(float value) { return static_cast<std::uint8_t>(value + 0.5f); }

}  // namespace fourd::pixel_filter
