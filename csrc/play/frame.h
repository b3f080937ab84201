// The arrays of a baked frame: points with all data that is needed to draw them without the trained model. The arrays
// are dense and row-major.
#pragma once

#include <cstdint>

#include "shade/shade.h"

namespace fourd::play {

struct Frame {
    shade::Points points;
    const std::uint16_t* radius;   // Shape (count,), as float16 in world units.
    const std::uint16_t* density;  // Shape (count,), as float16: alpha at the centre of each point.
    const std::uint8_t* normals = nullptr;  // Shape (count, 2): octahedral normals (points/octahedral.h), or null.
};

}  // namespace fourd::play
