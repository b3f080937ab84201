// The point renderer on the CPU. Callers check shapes; every pointer is to a dense row-major array.
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
    float near_depth;         // points with a smaller camera depth are culled; positive
    int layers;               // K, at least 1
    float transmittance_min;  // a pixel ends at this transmittance or below; 0 is exact
    int threads;              // at least 1; the result does not depend on it
    Simd simd;                // one that this machine runs
};

struct Image {
    float* features;  // (height, width, channels)
    float* alpha;     // (height, width)
    float* depth;     // (height, width), 0 where alpha is 0
};

// A picture of three channels, as bytes.
struct Canvas {
    std::uint8_t* rgba;   // (height, width, 4): colours over the background, and alpha; rounded
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

struct Workspace;  // defined in cpu/workspace.h; reusable memory

void render(const Cloud& cloud, const Settings& settings, Workspace& workspace, const Image& out);

// transmittance_min is ignored: gradients see all K layers.
void render_backward(const Cloud& cloud, const Settings& settings, Workspace& workspace, const ImageGradient& gradient,
                     const CloudGradient& out);

// out (count,): each point's largest weight (transmittance * alpha) in any pixel. cloud.features is not read.
void visibility(const Cloud& cloud, const Settings& settings, Workspace& workspace, float* out);

}  // namespace fourd::points
