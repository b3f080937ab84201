// The CPU point renderer. Callers check shapes; every pointer is to a dense row-major array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"
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
    Simd simd;                // one that this machine runs
};

struct Image {
    float* features;  // (height, width, channels)
    float* alpha;     // (height, width)
    float* depth;     // (height, width), 0 where alpha is 0
};

// A picture of three channels.
struct Canvas {
    std::uint8_t* rgba;   // (height, width, 4): colours over the background, and alpha; rounded
    float background[3];  // in [0, 1]
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

struct Workspace;  // in cpu/workspace.h: memory that the next picture can use again

void render(const Cloud& cloud, const Settings& settings, Workspace& space, const Image& out);

// transmittance_min is taken as 0: gradients see every one of the K layers.
void render_backward(const Cloud& cloud, const Settings& settings, Workspace& space, const ImageGradient& gradient,
                     const CloudGradient& out);

// out (count,): the largest weight (transmittance * alpha) that each point has in any pixel.
// cloud.features is not read.
void visibility(const Cloud& cloud, const Settings& settings, Workspace& space, float* out);

}  // namespace fourd::points
