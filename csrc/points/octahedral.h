// Unit vectors as points of an octahedron in two bytes (Cigolle et al. 2014, "A Survey of Efficient Representations for
// Independent Unit Vectors").
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "common/inline.h"
#include "points/maths.h"

namespace fourd::points {

// Decodes the bytes 127 x + 128 and 127 y + 128 of a point of the octahedron.
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

// Decodes the octahedral normals (count, 2), and rotates them from world axes to camera axes, into `out` (count, 3).
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

// The weight of a point in the depth and the normal of a visible surface, for the cosine between the point's normal and
// the direction to the camera. Points on the far side of the subject are visible where the near side has gaps or was
// not seen by any camera. Such points get a small weight, so that they count only where no other points are visible.
constexpr float kBackWeight = 0.1f;

FOURD_INLINE float front_weight(float cosine) {
    const float share = 0.5f + 5.0f * cosine, limited = share < 1.0f ? share : 1.0f;
    return kBackWeight + (1.0f - kBackWeight) * (limited > 0.0f ? limited : 0.0f);
}

// Computes the weights and the camera depths of points. `xyz` (count, 3) are positions in world axes, and `normals`
// (count, 3) are unit normals in camera axes.
FOURD_INLINE void front_weights(const Pinhole& camera, const float* xyz, const float* normals, std::size_t count,
                                float* weights, float* depths) {
    float r[9], t[3];
    for (int i = 0; i < 9; ++i) r[i] = camera.rotation[i];
    for (int i = 0; i < 3; ++i) t[i] = camera.translation[i];
    for (std::size_t i = 0; i < count; ++i) {
        const float *p = xyz + 3 * i, *n = normals + 3 * i;
        const float x = r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + t[0];
        const float y = r[3] * p[0] + r[4] * p[1] + r[5] * p[2] + t[1];
        const float z = r[6] * p[0] + r[7] * p[1] + r[8] * p[2] + t[2];
        const float length = std::sqrt(x * x + y * y + z * z + 1e-20f);
        depths[i] = z;
        weights[i] = front_weight(-(n[0] * x + n[1] * y + n[2] * z) / length);
    }
}

}  // namespace fourd::points
