// Points sampled in the source views around a camera. Callers check shapes; every pointer is to a dense row-major array.
#pragma once

#include <cstddef>

#include "sources/maths.h"

namespace fourd::sources {

struct Maps {
    const float* images;    // (views, 3, height, width)
    const float* mattes;    // (views, height, width) in [0, 1]
    const float* depth;     // (views, height, width), of the nearest surface; null: nothing hides points
    const float* features;  // (views, channels, feature_height, feature_width), over the same images; null for none
    int width, height;
    int channels, feature_width, feature_height;  // 0 without features
};

struct Query {
    Maps maps;
    const Pinhole* cameras;  // (views,)
    int views;
    const float* xyz;  // (count, 3)
    std::size_t count;
    float softness;    // depth over which a hidden point loses its say
};

struct Samples {
    float* channels;  // (views, channels + 3, count): features, then red, green and blue
    float* trust;     // (views, count)
};

struct Gradients {
    float* xyz;       // (count, 3)
    float* features;  // as Maps' features; null where it is not wanted
};

}  // namespace fourd::sources
