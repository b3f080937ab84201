// The networks of the point model as one function: from the features of a point and the samples of the source views to
// the point's radius, density, SH coefficients and colour. fourd/rendering/ops/heads/reference.py has the same function
// in plain torch and is the definition of every symbol. Callers check shapes, and arrays are dense.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::heads {

constexpr int kShTerms = 16;
constexpr int kSh = 3 * kShTerms;
constexpr int kMaxFeatures = 4096;
constexpr int kMaxHidden = 512;
constexpr int kMaxChannels = 64;
constexpr int kMaxViews = 64;
constexpr int kMaxTimeSamples = 1 << 16;

// Rows of internal arrays are padded to a multiple of kPad floats, which is a whole number of vectors of every
// instruction set.
constexpr int kPad = 16;
constexpr int padded(int size) { return (size + kPad - 1) / kPad * kPad; }

struct Sizes {
    int features, hidden, channels, views;
    int inputs;  // Of the first layers: the features, and those that are sampled from time planes.

    int hidden_stride() const { return padded(hidden); }
    int first_stride() const { return 3 * hidden_stride(); }
    int saved_stride() const { return 4 * hidden_stride(); }
    std::size_t saved_size(std::size_t count) const { return count * (saved_stride() + views); }
};

// The arrays of weights in torch's shapes (outputs, inputs), in the order in which Python passes them.
enum Weight {
    kGeometryFirst,
    kGeometryFirstBias,
    kGeometrySecond,
    kGeometrySecondBias,
    kGeometryLast,
    kGeometryLastBias,
    kBlendPoint,
    kBlendPointBias,
    kBlendImage,
    kBlendOut,
    kBlendOutBias,
    kShFirst,
    kShFirstBias,
    kShLast,
    kShLastBias,
    kWeightCount,
};

struct Shape {
    int rows, columns;
};

// The shape of an array of weights. Biases have one row.
inline Shape weight_shape(const Sizes& sizes, int weight) {
    const int f = sizes.inputs, h = sizes.hidden, c = sizes.channels;
    const Shape shapes[kWeightCount] = {{h, f}, {1, h}, {h, h}, {1, h}, {2, h}, {1, 2},   {h, f}, {1, h},
                                        {h, c}, {1, h}, {1, 1}, {h, f}, {1, h}, {kSh, h}, {1, kSh}};
    return shapes[weight];
}

struct Settings {
    float radius_low, radius_high;  // In point spacings.
    float radius_offset, density_offset;
    float logit_range;
    float sh_range;
    float own_share;  // Weight of the own colour; 0 to mix own colours and views' colours by visibility.
    float min_visibility;
    float centre[3];  // Of the viewing camera.
};

// A plane of features over one coordinate of space and time. All points have the same time, so the plane is a line.
struct TimePlane {
    const float* values;  // Shape (rows, samples, features), with at least 2 rows and 2 samples.
    int rows, samples;
    int axis;    // The coordinate in space, 0 to 2.
    int column;  // The first of the layers' inputs that the plane's features are.
};

struct TimePlanes {
    const TimePlane* at;
    int count;
    int features;              // Of each plane.
    const float* coordinates;  // Shape (points, 4), in [-1, 1]. Without planes, it is not read.
    float time;                // In [-1, 1].
};

struct Inputs {
    const float* features;      // Shape (count, features).
    const float* samples;       // Shape (views, channels, count). The last three channels are RGB.
    const float* visibility;    // Shape (views, count).
    const float* view_weights;  // Shape (views,).
    const float* own;           // Shape (count, 3), or null if points have no own colours.
    const float* xyz;           // Shape (count, 3).
    const float* spacing;       // Shape (count,).
    std::size_t count;
    TimePlanes time_planes;
};

struct Outputs {
    float* radius;   // Shape (count,).
    float* density;  // Shape (count,).
    float* sh;       // Shape (count, kSh).
    float* colour;   // Shape (count, 3).
    float* saved;    // saved_size(count) numbers for the gradient.
};

// Gradients of the loss with respect to Outputs.
struct Upstream {
    const float* radius;
    const float* density;
    const float* sh;  // Null if the loss does not depend on the SH coefficients themselves.
    const float* colour;
};

// What forward() has computed, which backward() reads.
struct Saved {
    const float* sh;     // Outputs::sh.
    const float* saved;  // Outputs::saved.
};

// Gradients of the loss with respect to Inputs, in the same shapes.
struct Gradients {
    float* features;
    float* samples;
    float* own;  // Null if Inputs::own is null.
    float* xyz;  // Only through the viewing direction.
    float* weights[kWeightCount];
    float* const* time_planes;
};

struct Execution {
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.
};

void forward(const Sizes& sizes, const Settings& settings, const float* const* weights, const Inputs& inputs,
             const Execution& execution, const Outputs& out);

void backward(const Sizes& sizes, const Settings& settings, const float* const* weights, const Inputs& inputs,
              const Execution& execution, const Saved& saved, const Upstream& upstream, const Gradients& out);

}  // namespace fourd::heads
