// Sets an array to zero before kernels add sums to it.
#pragma once

#include <cstddef>

#include "common/host_device.h"

namespace fourd::device {

struct Clear {
    float* values;

    FOURD_DEVICE void operator()(std::size_t index) const { values[index] = 0.0f; }
};

}  // namespace fourd::device
