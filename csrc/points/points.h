// The CPU point renderer. Callers check shapes; every pointer is to a dense row-major array.
#pragma once

#include <cstddef>

#include "points/maths.h"

namespace fourd::points {

struct Cloud {
    const float* xyz;       // (count, 3)
    const float* features;  // (count, channels)
    const float* radius;    // (count,)
    const float* density;   // (count,)
    std::size_t count;      // below 2^31
    int channels;           // 1 to 32
};

struct Settings {
    Pinhole camera;
    float near;               // points with camera depth below it are culled; above 0
    int layers;               // K, at least 1
    float transmittance_min;  // a pixel ends where its transmittance is this or less; 0 is exact
    int threads;              // at least 1; the result does not depend on it
    const char* simd;         // "baseline", "avx2", "avx512" or "" for the widest this machine runs
};

struct Image {
    float* features;  // (height, width, channels)
    float* alpha;     // (height, width)
    float* depth;     // (height, width), 0 where alpha is 0
};

struct ImageGradient {
    const float* features;
    const float* alpha;
    const float* depth;  // or null for none
};

struct CloudGradient {
    float* xyz;
    float* features;
    float* radius;
    float* density;
};

void render(const Cloud& cloud, const Settings& settings, const Image& out);

// transmittance_min is taken as 0: gradients see every one of the K layers.
void render_backward(const Cloud& cloud, const Settings& settings, const ImageGradient& gradient,
                     const CloudGradient& out);

// out (count,): the largest weight (transmittance * alpha) that each point has in any pixel.
// cloud.features is not read.
void visibility(const Cloud& cloud, const Settings& settings, float* out);

// The instruction set that a Settings::simd of "" means here.
const char* simd_default();

// Whether this machine runs the instruction set of that name.
bool simd_available(const char* name);

}  // namespace fourd::points
