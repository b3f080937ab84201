// The point renderer on the CPU. Callers check shapes. Every pointer points to a dense row-major array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"
#include "points/maths.h"

namespace fourd::points {

struct Cloud {
    const float* xyz;       // Shape (count, 3).
    const float* features;  // Shape (count, channels).
    const float* radius;    // Shape (count,).
    const float* density;   // Shape (count,).
    std::size_t count;      // Below 2^31.
    int channels;           // From 1 to 32.
};

struct Settings {
    Pinhole camera;
    float near_depth;         // Positive. Points with a camera depth below near_depth are culled.
    int layers;               // Maximum number K of points that a pixel composites, at least 1.
    // Compositing of a pixel ends when its transmittance is at or below this value. With the value 0, this early end
    // does not change the image.
    float transmittance_min;
    int threads;              // At least 1. The result is the same for any number of threads.
    Simd simd;                // An instruction set that this machine supports.
};

struct Image {
    float* features;  // Shape (height, width, channels).
    float* alpha;     // Shape (height, width).
    float* depth;     // Shape (height, width). Where alpha is 0, depth is 0.
};

// An 8-bit image of three colour channels and alpha.
struct Canvas {
    std::uint8_t* rgba;   // Shape (height, width, 4): rounded colours over the background, then alpha.
    float background[3];  // Each channel is in [0, 1].
};

// An 8-bit image, and the depth and the normal of the surface that is visible at each pixel.
struct Surface {
    Canvas canvas;  // If the background is black, the colours are premultiplied by alpha.
    // Shape (height, width): the quotient coverage / depth. The coverage is clamp(3 * A - 1/2, 0, 1), where A is the
    // alpha of the pixel. `depth` is a weighted mean of the camera depths of the points that hit the pixel. The weight
    // of a point is transmittance * alpha * front_weight. Here alpha is the alpha of the point at this pixel, and
    // front_weight (points/front_weight.h) is small for points that face away from the camera.
    float* inverse_depth;
    // Shape (height, width, 4): unit normal n as bytes 127 * n + 128, then 255 * coverage. At pixels without points, n
    // is the zero vector and the coverage is 0, so the bytes are 128, 128, 128 and 0.
    std::uint8_t* normal;
    // Weight of the previous image, in [0, 1). At pixels at which the previous image and the new image show the same
    // surface, the inverse depths of the two images are averaged, and so are the normals. In these means, the previous
    // image has the weight `persistence`, and the new image has the weight 1 - persistence. If `persistence` is above
    // 0, all arrays must contain the previous image of the same camera before the call.
    float persistence;
};

// The gradient of the loss with respect to the arrays of Image, in the same shapes.
struct ImageGradient {
    const float* features;
    const float* alpha;
    const float* depth;  // Null if the loss does not depend on the depth.
};

// The gradient of the loss with respect to the arrays of Cloud, in the same shapes.
struct CloudGradient {
    float* xyz;
    float* features;
    float* radius;
    float* density;
};

struct Workspace;  // Reusable memory. This type is defined in cpu/workspace.h.

void render(const Cloud& cloud, const Settings& settings, Workspace& workspace, const Image& out);

// Computes the gradient of render(). At each pixel, the function uses the nearest points that hit the pixel, up to
// settings.layers of them. It ignores settings.transmittance_min.
void render_backward(const Cloud& cloud, const Settings& settings, Workspace& workspace, const ImageGradient& gradient,
                     const CloudGradient& out);

// For each point, writes its largest weight (transmittance * alpha) over all pixels to `out` (count,). cloud.features
// is not read.
void visibility(const Cloud& cloud, const Settings& settings, Workspace& workspace, float* out);

}  // namespace fourd::points
