// Projects points into source views, and samples the views at the projections. Callers check shapes. Every pointer
// points to a dense row-major array.
#pragma once

#include <cmath>
#include <cstddef>

#include "common/simd.h"
#include "sources/maths.h"

namespace fourd::sources {

// Images, mattes, depth maps and feature maps of the source views. Each map covers the whole image of its view.
struct Maps {
    const float* images;    // Shape (views, 3, height, width).
    const float* mattes;    // Shape (views, height, width). Values are in [0, 1].
    const float* depth;     // Shape (views, height, width): depth of the nearest surface. Null disables occlusion
                            // tests.
    const float* features;  // Shape (views, feature_height, feature_width, channels), or null.
    int width, height;
    int channels, feature_width, feature_height;  // The feature sizes and `channels` are 0 if `features` is null.
};

struct Query {
    Maps maps;
    const Pinhole* cameras;  // Shape (views,).
    int views;
    const float* xyz;  // Shape (count, 3).
    std::size_t count;
    // Shape (count,): length, in world units, over which the visibility decays behind a surface. sample_backward() does
    // not read softness.
    const float* softness;
    int threads;  // At least 1. Only the CPU uses threads, and the result does not depend on their number.
    Simd simd;    // An instruction set that this machine supports. Only the CPU uses simd.
};

struct Samples {
    float* channels;    // Shape (views, channels + 3, count): features, then red, green and blue.
    float* visibility;  // Shape (views, count).
};

// Gradients with respect to the inputs. All gradients are computed from the gradient with respect to Samples::channels.
// The visibility is treated as constant.
struct Gradients {
    float* xyz;       // Shape (count, 3).
    float* features;  // Null, or an array with the shape of Maps::features.
};

// Returns the offsets and weights of the four samples around a projected point, in the image of a view.
FOURD_HD FOURD_INLINE Bilinear bilinear_in_image(const Maps& maps, const Projection& at) {
    return bilinear_at(at.u - 0.5f, at.v - 0.5f, maps.width, maps.height);
}

// Returns the number of feature samples per image pixel, along x.
FOURD_HD FOURD_INLINE float feature_scale_x(const Maps& maps) {
    return static_cast<float>(maps.feature_width) / static_cast<float>(maps.width);
}

FOURD_HD FOURD_INLINE float feature_scale_y(const Maps& maps) {
    return static_cast<float>(maps.feature_height) / static_cast<float>(maps.height);
}

// Returns the offsets and weights of the four samples around a projected point, in the features of a view.
FOURD_HD FOURD_INLINE Bilinear bilinear_in_features(const Maps& maps, const Projection& at) {
    return bilinear_at(at.u * feature_scale_x(maps) - 0.5f, at.v * feature_scale_y(maps) - 0.5f, maps.feature_width,
                       maps.feature_height);
}

FOURD_HD FOURD_INLINE int nearest_index(float place, int size) {
    const float last = static_cast<float>(size - 1);
    place = place > 0.0f ? place : 0.0f;
    return static_cast<int>(std::rint(place < last ? place : last));
}

// Softness values that are NaN or smaller than kMinSoftness are replaced by kMinSoftness.
constexpr float kMinSoftness = 1e-12f;

// Returns the visibility weight of a view at a point: the squared matte times a decay factor. The factor is 1 up to a
// distance of 2 * softness behind the visible surface, and decays exponentially beyond this distance. The matte is
// squared because pixels on the silhouette contain some background.
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

// Computes the gradients, and overwrites all arrays of `out`.
void sample_backward(const Query& query, const float* gradient, const Gradients& out);

}  // namespace fourd::sources
