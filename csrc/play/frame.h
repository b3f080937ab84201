// The arrays of a baked frame, which are dense and row-major.
#pragma once

#include <cstdint>

#include "shade/shade.h"

namespace fourd::play {

struct Frame {
    shade::Points points;
    const std::uint16_t* radius;   // (count,) float16, world units
    const std::uint16_t* density;  // (count,) float16
};

}  // namespace fourd::play
