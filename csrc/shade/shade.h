// Computes the colours of baked points as seen from a camera. A colour is a blend of a few source views plus spherical
// harmonics. Callers check shapes. Every pointer points to a dense row-major array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"

namespace fourd::shade {

constexpr int kTerms = 16;      // real spherical harmonics up to degree 3
constexpr int kMaxChosen = 64;  // maximum number of source views to blend

struct Points {
    const float* xyz;              // (count, 3)
    const std::uint16_t* sh;       // (count, 3, 16) float16
    const std::uint16_t* weights;  // (count, views) float16, not negative
    const std::uint8_t* rgb;       // (count, views, 3)
    std::size_t count;
    std::size_t views;
};

struct Settings {
    const std::int32_t* chosen;  // (chosen_count,) columns of the views to blend
    int chosen_count;            // 0 to kMaxChosen
    double centre[3];            // position of the camera in the world
    float sh_range;              // colour += sh_base + sh_range * tanh(sh . Y(d))
    float sh_base;
    int threads;  // at least 1; does not change the result
    Simd simd;    // an instruction set that this machine supports
};

// Writes the colours to out (count, 3). The bits are the same for any number of threads.
void shade(const Points& points, const Settings& settings, float* out);

// Shades points [begin, end) on the caller's thread. out is indexed by point.
void shade_some(const Points& points, const Settings& settings, std::size_t begin, std::size_t end, float* out);

}  // namespace fourd::shade
