// The fade of points at the near plane, for the players of baked frames on the CPU and on a GPU.
#pragma once

#include "common/host_device.h"
#include "points/maths.h"

namespace fourd::play {

// Depth over which a point fades, as a fraction of the depth of the near plane.
constexpr float kFadeShare = 0.5f;

// Returns the density of a point after the fade: the density, which is first limited to 1, is multiplied by
// clamp((z - near_depth) / (kFadeShare * near_depth), 0, 1), where z is the point's camera depth. A point at the near
// plane thus has density 0, and points at or beyond 1.5 * near_depth keep their density. fourd/rendering/ops/play/near_fade.py
// gives the reason for the fade. If a number is NaN or infinite, the renderer culls the point with the returned density,
// as it does with the given density. The depth is computed as in points::project.
FOURD_HD static inline float faded_density(const points::Pinhole& camera, float near_depth, const float* xyz,
                                           float density) {
    const float max_float = 3.402823466e38f;
    const float* r = camera.rotation;
    const float z = r[6] * xyz[0] + r[7] * xyz[1] + r[8] * xyz[2] + camera.translation[2];
    const float fade = (z - near_depth) / (kFadeShare * near_depth);
    const float limited = (density > 1.0f) & (density <= max_float) ? 1.0f : density;
    const float positive = fade > 0.0f ? fade : 0.0f;
    return limited * (positive < 1.0f ? positive : 1.0f);
}

}  // namespace fourd::play
