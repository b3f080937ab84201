// What a source view holds at a point: bilinear samples of its maps where the point projects to.
#pragma once

#include <cstddef>

#include "common/host_device.h"

namespace fourd::sources {

// A pinhole: x_camera = rotation * x_world + translation; pixels = intrinsics * x_camera / z.
struct Pinhole {
    float intrinsics[9];
    float rotation[9];
    float translation[3];
};

// A point in a view. Where it is not in front of the camera, it lies far outside the image, and moves nothing.
struct Projected {
    float u, v;  // pixels of the image
    float z;
    bool in_front;
};

FOURD_HD static inline Projected project(const Pinhole& camera, const float* xyz) {
    const float *r = camera.rotation, *k = camera.intrinsics;
    float at[3];
    for (int i = 0; i < 3; ++i) {
        at[i] = r[3 * i] * xyz[0] + r[3 * i + 1] * xyz[1] + r[3 * i + 2] * xyz[2] + camera.translation[i];
    }
    if (!(at[2] > 1e-6f)) return {-1e6f, -1e6f, at[2], false};
    return {(k[0] * at[0] + k[1] * at[1] + k[2] * at[2]) / at[2], (k[3] * at[0] + k[4] * at[1] + k[5] * at[2]) / at[2],
            at[2], true};
}

// Adds to the point's gradient what moves its pixel by (grad_u, grad_v).
FOURD_HD static inline void project_backward(const Pinhole& camera, const Projected& at, float grad_u, float grad_v,
                                             float* grad_xyz) {
    if (!at.in_front) return;
    const float *r = camera.rotation, *k = camera.intrinsics;
    const float x = (k[0] * grad_u + k[3] * grad_v) / at.z;
    const float y = (k[1] * grad_u + k[4] * grad_v) / at.z;
    const float z = ((k[2] - at.u) * grad_u + (k[5] - at.v) * grad_v) / at.z;
    for (int i = 0; i < 3; ++i) grad_xyz[i] = r[i] * x + r[3 + i] * y + r[6 + i] * z;
}

// The four samples around a place in a map of height x width, as torch's grid_sample takes them with
// align_corners off: sample (0, 0) lies half a sample from the border, and 0 lies beyond.
struct Around {
    std::size_t offset[4];  // row by row; 0 where there is no sample
    float weight[4];        // 0 there
    float across[4];        // the weights' slopes along the width, per sample; 0 there
    float down[4];
};

FOURD_HD static inline Around around(float x, float y, int width, int height) {
    Around out{};
    // Beyond these nothing is near, and what is no number is beyond.
    if (!(x > -1.0f && y > -1.0f && x < static_cast<float>(width) && y < static_cast<float>(height))) return out;
    const int left = static_cast<int>(x + 1.0f) - 1, top = static_cast<int>(y + 1.0f) - 1;
    const float right_share = x - static_cast<float>(left), bottom_share = y - static_cast<float>(top);
    for (int corner = 0; corner < 4; ++corner) {
        const bool right = corner % 2 == 1, bottom = corner / 2 == 1;
        const int column = left + (right ? 1 : 0), row = top + (bottom ? 1 : 0);
        if (column < 0 || row < 0 || column >= width || row >= height) continue;
        const float wx = right ? right_share : 1.0f - right_share, wy = bottom ? bottom_share : 1.0f - bottom_share;
        out.offset[corner] = static_cast<std::size_t>(row) * width + column;
        out.weight[corner] = wx * wy;
        out.across[corner] = right ? wy : -wy;
        out.down[corner] = bottom ? wx : -wx;
    }
    return out;
}

// How the sum of a map's samples, times g, changes as the place moves; added to a pixel's gradient.
FOURD_HD static inline void move(float value, const Around& at, int corner, float g, float* grad_u, float* grad_v) {
    if (at.across[corner] != 0.0f) *grad_u += g * at.across[corner] * value;
    if (at.down[corner] != 0.0f) *grad_v += g * at.down[corner] * value;
}

FOURD_HD static inline float sample(const float* map, const Around& at) {
    float sum = 0.0f;
    for (int corner = 0; corner < 4; ++corner) {
        if (at.weight[corner] != 0.0f) sum += at.weight[corner] * map[at.offset[corner]];
    }
    return sum;
}

}  // namespace fourd::sources
