// The point renderer on the CPU. Callers check shapes. Every pointer points to a dense row-major array.
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
    float near_depth;         // positive; points with a smaller camera depth are culled
    int layers;               // K, at least 1
    float transmittance_min;  // a pixel is complete at or below this transmittance; 0 is exact
    int threads;              // at least 1; does not change the result
    Simd simd;                // an instruction set that this machine supports
};

struct Image {
    float* features;  // (height, width, channels)
    float* alpha;     // (height, width)
    float* depth;     // (height, width), 0 where alpha is 0
};

// An image of three channels, as bytes.
struct Canvas {
    std::uint8_t* rgba;   // (height, width, 4): colours over the background and alpha, rounded
    float background[3];  // in [0, 1]
};

struct ImageGradient {
    const float* features;
    const float* alpha;
    const float* depth;  // may be null
};

struct CloudGradient {
    float* xyz;
    float* features;
    float* radius;
    float* density;
};

struct Workspace;  // reusable memory, defined in cpu/workspace.h

void render(const Cloud& cloud, const Settings& settings, Workspace& workspace, const Image& out);

// transmittance_min is ignored, because the backward pass always uses all K layers.
void render_backward(const Cloud& cloud, const Settings& settings, Workspace& workspace, const ImageGradient& gradient,
                     const CloudGradient& out);

// out (count,) is the largest weight (transmittance * alpha) of each point in any pixel. cloud.features is not read.
void visibility(const Cloud& cloud, const Settings& settings, Workspace& workspace, float* out);

}  // namespace fourd::points
