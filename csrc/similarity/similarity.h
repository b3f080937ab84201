// Structural similarity (SSIM, Wang et al. 2004) of two pictures with an 11 x 11 Gaussian window of sigma 1.5, for
// values in [0, 1], and its gradient. Callers check shapes. Every pointer points to a dense row-major array.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::similarity {

constexpr int kWindow = 11;

struct Pictures {
    const float* picture;  // (height, width, channels)
    const float* truth;    // same shape as picture
    int width, height;     // at least kWindow
    int channels;          // at least 1
    int threads;           // at least 1; does not change the result
    Simd simd;             // an instruction set that this machine supports
};

// Returns the mean over channels and over the pixels whose window lies inside the picture. Unless gradient is null,
// writes the gradient of this mean with respect to the picture (height, width, channels).
double similarity(const Pictures& pictures, float* gradient);

}  // namespace fourd::similarity
