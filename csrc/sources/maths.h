// Samples the maps of a source view bilinearly at the projections of points.
#pragma once

#include <cstddef>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::sources {

// A pinhole camera: x_camera = rotation * x_world + translation; pixels = intrinsics * x_camera / z, where z is the
// third coordinate of x_camera.
struct Pinhole {
    float intrinsics[9];
    float rotation[9];
    float translation[3];
};

// A point projected into a source view. A point behind the camera gets a position far outside the image and has no
// gradient.
struct Projection {
    float u, v;  // Position in the image, in pixels.
    float z;     // Camera depth.
    bool in_front;
};

FOURD_HD FOURD_INLINE Projection project(const Pinhole& camera, const float* xyz) {
    const float *r = camera.rotation, *k = camera.intrinsics;
    float at[3];
    for (int i = 0; i < 3; ++i) {
        at[i] = r[3 * i] * xyz[0] + r[3 * i + 1] * xyz[1] + r[3 * i + 2] * xyz[2] + camera.translation[i];
    }
    if (!(at[2] > 1e-6f)) return {-1e6f, -1e6f, at[2], false};
    return {(k[0] * at[0] + k[1] * at[1] + k[2] * at[2]) / at[2], (k[3] * at[0] + k[4] * at[1] + k[5] * at[2]) / at[2],
            at[2], true};
}

// Computes the gradient of the point from the gradient of its pixel position, and writes it to grad_xyz. If the point
// is behind the camera, the function does not change grad_xyz.
FOURD_HD FOURD_INLINE void project_backward(const Pinhole& camera, const Projection& at, float grad_u, float grad_v,
                                            float* grad_xyz) {
    if (!at.in_front) return;
    const float *r = camera.rotation, *k = camera.intrinsics;
    const float x = (k[0] * grad_u + k[3] * grad_v) / at.z;
    const float y = (k[1] * grad_u + k[4] * grad_v) / at.z;
    const float z = ((k[2] - at.u) * grad_u + (k[5] - at.v) * grad_v) / at.z;
    for (int i = 0; i < 3; ++i) grad_xyz[i] = r[i] * x + r[3 + i] * y + r[6 + i] * z;
}

// The four samples around a position in a map of height x width samples, row by row. As in grid_sample of torch with
// align_corners=False, the centre of sample (0, 0) is half a sample from the border. A sample outside the map has the
// weight 0 and the offset of a sample inside the map, so that the read is valid.
struct Bilinear {
    std::size_t offset[4];
    float weight[4];
    float slope_x[4];  // Derivatives of the weights with respect to x, where x is measured in samples.
    float slope_y[4];
};

FOURD_HD FOURD_INLINE Bilinear bilinear_at(float x, float y, int width, int height) {
    // `inside` is false if the position is NaN, or outside the bounds in the next line. Such a position is replaced by
    // (-1, -1), where all weights are 0, so no sample is used.
    const bool inside = x > -1.0f && y > -1.0f && x < static_cast<float>(width) && y < static_cast<float>(height);
    x = inside ? x : -1.0f;
    y = inside ? y : -1.0f;
    const int left = static_cast<int>(x + 1.0f) - 1, top = static_cast<int>(y + 1.0f) - 1;
    const float right_fraction = x - static_cast<float>(left), bottom_fraction = y - static_cast<float>(top);
    const float in_left = inside && left >= 0 ? 1.0f : 0.0f, in_right = inside && left + 1 < width ? 1.0f : 0.0f;
    const float in_top = top >= 0 ? 1.0f : 0.0f, in_bottom = top + 1 < height ? 1.0f : 0.0f;
    const float wl = (1.0f - right_fraction) * in_left, wr = right_fraction * in_right;
    const float wt = (1.0f - bottom_fraction) * in_top, wb = bottom_fraction * in_bottom;
    const std::size_t column = left >= 0 ? left : 0, next = left + 1 < width ? left + 1 : left;
    const std::size_t row = static_cast<std::size_t>(top >= 0 ? top : 0) * width;
    const std::size_t below = static_cast<std::size_t>(top + 1 < height ? top + 1 : top) * width;
    return {{row + column, row + next, below + column, below + next},
            {wl * wt, wr * wt, wl * wb, wr * wb},
            {-in_left * wt, in_right * wt, -in_left * wb, in_right * wb},
            {-wl * in_top, -wr * in_top, wl * in_bottom, wr * in_bottom}};
}

FOURD_HD FOURD_INLINE float sample(const float* map, const Bilinear& at) {
    return at.weight[0] * map[at.offset[0]] + at.weight[1] * map[at.offset[1]] + at.weight[2] * map[at.offset[2]] +
           at.weight[3] * map[at.offset[3]];
}

// The gradient with respect to a position in a map. The position is measured in samples of the map.
struct PixelGradient {
    float u, v;
};

FOURD_HD FOURD_INLINE void add_pixel_gradient(PixelGradient& sum, const Bilinear& at, int corner, float value_times_g) {
    sum.u += at.slope_x[corner] * value_times_g;
    sum.v += at.slope_y[corner] * value_times_g;
}

}  // namespace fourd::sources
