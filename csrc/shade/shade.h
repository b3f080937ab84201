// Computes the colours of points as seen from a camera. A colour is a blend of a few source views plus spherical
// harmonics (SH). The points are baked: their colours in the source views, blend weights and SH coefficients are stored
// with them. Callers check shapes. Every pointer points to a dense row-major array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"

namespace fourd::shade {

constexpr int kTerms = 16;      // Number of real spherical harmonics up to degree 3.
constexpr int kMaxChosen = 64;  // Maximum number of source views to blend.

struct Points {
    const float* xyz;              // Shape (count, 3).
    const std::uint16_t* sh;       // Shape (count, 3, 16), as float16.
    const std::uint16_t* weights;  // Shape (count, views), as float16: blend weights, which are not negative.
    const std::uint8_t* rgb;       // Shape (count, views, 3): colours of the points in the source views.
    std::size_t count;
    std::size_t views;
};

struct Settings {
    const std::int32_t* chosen;  // Shape (chosen_count,): indices of the views to blend.
    // Shape (chosen_count,): factors in [0, 1] by which the blend weights are multiplied. At least one factor is not 0.
    const float* view_weights;
    int chosen_count;            // From 0 to kMaxChosen.
    double centre[3];            // Position of the camera in world coordinates.
    // The SH colour is sh_base + sh_range * tanh(dot(sh, Y(direction))). Y returns the kTerms spherical harmonics, and
    // `direction` is the direction from the camera to the point.
    float sh_range;
    float sh_base;
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.
};

// Writes the colours to `out` (count, 3). The colours have the same bits for any number of threads.
void shade(const Points& points, const Settings& settings, float* out);

// Computes the colours of points [begin, end) on the thread of the caller. Row i of `out` is the colour of point i.
void shade_some(const Points& points, const Settings& settings, std::size_t begin, std::size_t end, float* out);

}  // namespace fourd::shade
