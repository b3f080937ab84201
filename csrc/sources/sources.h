// Points sampled in the source views around a camera. Callers check shapes; every pointer is to a dense row-major array.
#pragma once

#include <cmath>
#include <cstddef>

#include "common/simd.h"
#include "sources/maths.h"

namespace fourd::sources {

struct Maps {
    const float* images;    // (views, 3, height, width)
    const float* mattes;    // (views, height, width) in [0, 1]
    const float* depth;     // (views, height, width), of the nearest surface; null: nothing hides points
    const float* features;  // (views, feature_height, feature_width, channels), over the same images; null for none
    int width, height;
    int channels, feature_width, feature_height;  // 0 without features
};

struct Query {
    Maps maps;
    const Pinhole* cameras;  // (views,)
    int views;
    const float* xyz;  // (count, 3)
    std::size_t count;
    const float* softness;  // (count,) depth over which a hidden point loses its say; the gradient needs none
    int threads;       // at least 1; the result does not depend on it. Of the CPU alone, as is
    Simd simd;         // one that this machine runs
};

struct Samples {
    float* channels;  // (views, channels + 3, count): features, then red, green and blue
    float* trust;     // (views, count)
};

// With respect to Samples' channels; trust has none.
struct Gradients {
    float* xyz;       // (count, 3)
    float* features;  // as Maps' features; null where it is not wanted
};

// The samples around a point in a view's image, and in its features.
FOURD_HD FOURD_INLINE Around around_in_image(const Maps& maps, const Projected& at) {
    return around(at.u - 0.5f, at.v - 0.5f, maps.width, maps.height);
}

// Samples of the features a pixel of the image.
FOURD_HD FOURD_INLINE float feature_scale_across(const Maps& maps) {
    return static_cast<float>(maps.feature_width) / static_cast<float>(maps.width);
}

FOURD_HD FOURD_INLINE float feature_scale_down(const Maps& maps) {
    return static_cast<float>(maps.feature_height) / static_cast<float>(maps.height);
}

FOURD_HD FOURD_INLINE Around around_in_features(const Maps& maps, const Projected& at) {
    return around(at.u * feature_scale_across(maps) - 0.5f, at.v * feature_scale_down(maps) - 0.5f,
                  maps.feature_width, maps.feature_height);
}

FOURD_HD FOURD_INLINE int nearest(float place, int size) {
    const float last = static_cast<float>(size - 1);
    place = place > 0.0f ? place : 0.0f;
    return static_cast<int>(std::rint(place < last ? place : last));
}

constexpr float kLeastSoftness = 1e-12f;  // what is less, or no number, stands for this

// How far a view can be trusted at a point. A pixel on the silhouette mixes in background, so that trust falls
// faster than coverage does.
FOURD_HD FOURD_INLINE float trust(const Maps& maps, std::size_t view, const Projected& at, const Around& image,
                                   float softness) {
    if (!(at.z > 0.0f)) return 0.0f;
    const std::size_t size = static_cast<std::size_t>(maps.width) * maps.height;
    const float matte = sample(maps.mattes + view * size, image);
    if (!maps.depth || matte == 0.0f) return matte * matte;
    const std::size_t row = nearest(at.v - 0.5f, maps.height), column = nearest(at.u - 0.5f, maps.width);
    const float width = softness > kLeastSoftness ? softness : kLeastSoftness;
    const float behind = at.z - maps.depth[view * size + row * maps.width + column] - 2.0f * width;
    return behind > 0.0f ? matte * matte * std::exp(-behind / width) : matte * matte;
}

void sample(const Query& query, const Samples& out);

// All of out is written; features where there are any.
void sample_backward(const Query& query, const float* gradient, const Gradients& out);

}  // namespace fourd::sources
