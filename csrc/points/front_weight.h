// Reduces the weights of points whose surface faces away from the camera.
#pragma once

#include <cmath>
#include <cstddef>

#include "common/inline.h"
#include "points/maths.h"

namespace fourd::points {

// The depth and the normal of the visible surface at a pixel are weighted means over points. The weight of a point is
// multiplied by front_weight(cosine), where `cosine` is the cosine of the angle between the point's normal and the
// direction to the camera. Points on the far side of the subject show through where the near side has gaps or was not
// seen by any camera. Because their normals face away from the camera, they get a small weight and matter only where no
// other points are visible.
constexpr float kBackWeight = 0.1f;

FOURD_INLINE float front_weight(float cosine) {
    const float share = 0.5f + 5.0f * cosine, limited = share < 1.0f ? share : 1.0f;
    return kBackWeight + (1.0f - kBackWeight) * (limited > 0.0f ? limited : 0.0f);
}

// Writes the weights and the camera depths of points to `weights` (count,) and `depths` (count,). `xyz` (count, 3) are
// positions in world axes, and `normals` (count, 3) are unit normals in camera axes.
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
