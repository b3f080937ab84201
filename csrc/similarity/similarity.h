// Computes the structural similarity (SSIM, Wang et al. 2004) of two pictures, and its gradient. The window is
// Gaussian, with 11 x 11 pixels and a sigma of 1.5 pixels. Pixel values are in [0, 1]. Callers check shapes. Every
// pointer points to a dense row-major array.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::similarity {

constexpr int kWindow = 11;

struct Pictures {
    const float* picture;  // Shape (height, width, channels).
    const float* truth;    // Shape (height, width, channels): the reference picture.
    int width, height;     // At least kWindow.
    int channels;          // At least 1.
    int threads;           // At least 1. The result is the same for any number of threads.
    Simd simd;             // An instruction set that this machine supports.
};

// Returns the mean similarity over all channels and over the pixels whose window is inside the picture. If `gradient`
// (height, width, channels) is not null, the function also writes to it the gradient of this mean with respect to the
// picture.
double similarity(const Pictures& pictures, float* gradient);

}  // namespace fourd::similarity
