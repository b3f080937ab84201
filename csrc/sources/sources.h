// Samples of the source views around a camera, at points. Callers check shapes; every pointer is to a dense row-major
// array.
#pragma once

#include <cmath>
#include <cstddef>

#include "common/simd.h"
#include "sources/maths.h"

namespace fourd::sources {

struct Maps {
    const float* images;    // (views, 3, height, width)
    const float* mattes;    // (views, height, width) in [0, 1]
    const float* depth;     // (views, height, width), of the nearest surface; null: no occlusion
    const float* features;  // (views, feature_height, feature_width, channels), over the same images; may be null
    int width, height;
    int channels, feature_width, feature_height;  // 0 without features
};

struct Query {
    Maps maps;
    const Pinhole* cameras;  // (views,)
    int views;
    const float* xyz;  // (count, 3)
    std::size_t count;
    const float*
        softness;  // (count,) depth over which an occluded point loses its visibility weight; unused by the gradient
    int threads;   // at least 1; the result does not depend on it; CPU only
    Simd simd;     // one that this machine runs; CPU only
};

struct Samples {
    float* channels;    // (views, channels + 3, count): features, then red, green and blue
    float* visibility;  // (views, count)
};

// Gradients given that of Samples' channels; visibility has none.
struct Gradients {
    float* xyz;       // (count, 3)
    float* features;  // shaped as Maps' features; may be null
};

// The samples around a point in a view's image, and in its features.
FOURD_HD FOURD_INLINE Bilinear bilinear_in_image(const Maps& maps, const Projection& at) {
    return bilinear_at(at.u - 0.5f, at.v - 0.5f, maps.width, maps.height);
}

// Feature samples per pixel of the image.
FOURD_HD FOURD_INLINE float feature_scale_x(const Maps& maps) {
    return static_cast<float>(maps.feature_width) / static_cast<float>(maps.width);
}

FOURD_HD FOURD_INLINE float feature_scale_y(const Maps& maps) {
    return static_cast<float>(maps.feature_height) / static_cast<float>(maps.height);
}

FOURD_HD FOURD_INLINE Bilinear bilinear_in_features(const Maps& maps, const Projection& at) {
    return bilinear_at(at.u * feature_scale_x(maps) - 0.5f, at.v * feature_scale_y(maps) - 0.5f, maps.feature_width,
                       maps.feature_height);
}

FOURD_HD FOURD_INLINE int nearest_index(float place, int size) {
    const float last = static_cast<float>(size - 1);
    place = place > 0.0f ? place : 0.0f;
    return static_cast<int>(std::rint(place < last ? place : last));
}

constexpr float kMinSoftness = 1e-12f;  // replaces smaller values and NaN

// The visibility weight of a view at a point: the squared matte, times an exponential decay with the depth behind the
// surface. Squared, because pixels on the silhouette mix in background.
FOURD_HD FOURD_INLINE float visibility(const Maps& maps, std::size_t view, const Projection& at, const Bilinear& image,
                                       float softness) {
    if (!(at.z > 0.0f)) return 0.0f;
    const std::size_t size = static_cast<std::size_t>(maps.width) * maps.height;
    const float matte = sample(maps.mattes + view * size, image);
    if (!maps.depth || matte == 0.0f) return matte * matte;
    const std::size_t row = nearest_index(at.v - 0.5f, maps.height), column = nearest_index(at.u - 0.5f, maps.width);
    const float width = softness > kMinSoftness ? softness : kMinSoftness;
    const float behind = at.z - maps.depth[view * size + row * maps.width + column] - 2.0f * width;
    return behind > 0.0f ? matte * matte * std::exp(-behind / width) : matte * matte;
}

void sample(const Query& query, const Samples& out);

// Overwrites all of out.
void sample_backward(const Query& query, const float* gradient, const Gradients& out);

}  // namespace fourd::sources
