// Decodes unit vectors that are stored in two bytes with the octahedral mapping (Cigolle et al. 2014, "A Survey of
// Efficient Representations for Independent Unit Vectors").
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "common/inline.h"
#include "points/maths.h"

namespace fourd::points {

// Decodes an octahedral normal to the unit vector `normal`. The two bytes are 127 * x + 128 and 127 * y + 128, where
// (x, y) in [-1, 1]^2 is a position in the octahedral map.
FOURD_INLINE void from_octahedral(const std::uint8_t* bytes, float* normal) {
    const float x = static_cast<float>(bytes[0]) / 127.0f - 128.0f / 127.0f;
    const float y = static_cast<float>(bytes[1]) / 127.0f - 128.0f / 127.0f;
    const float z = 1.0f - std::fabs(x) - std::fabs(y);
    const float fold = z < 0.0f ? -z : 0.0f;
    const float folded[3] = {x > 0.0f ? x - fold : x + fold, y > 0.0f ? y - fold : y + fold, z};
    const float scale =
        1.0f / std::sqrt(folded[0] * folded[0] + folded[1] * folded[1] + folded[2] * folded[2] + 1e-20f);
    for (int axis = 0; axis < 3; ++axis) normal[axis] = scale * folded[axis];
}

// Decodes the octahedral normals (count, 2), rotates them from world axes to camera axes, and writes them to `out`
// (count, 3).
FOURD_INLINE void turn_octahedral(const Pinhole& camera, const std::uint8_t* octahedral, std::size_t count,
                                  float* out) {
    float r[9];
    for (int i = 0; i < 9; ++i) r[i] = camera.rotation[i];
    for (std::size_t i = 0; i < count; ++i) {
        float n[3];
        from_octahedral(octahedral + 2 * i, n);
        out[3 * i] = r[0] * n[0] + r[1] * n[1] + r[2] * n[2];
        out[3 * i + 1] = r[3] * n[0] + r[4] * n[1] + r[5] * n[2];
        out[3 * i + 2] = r[6] * n[0] + r[7] * n[1] + r[8] * n[2];
    }
}

}  // namespace fourd::points
