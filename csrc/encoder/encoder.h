// The image encoder as one function: from the source images to their features. The module ImageEncoder and
// fourd/rendering/ops/encoder/reference.py have the same network in plain torch and define every layer. Callers check
// shapes, and arrays are dense.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::encoder {

constexpr int kMaxFeatures = 64;

// Channels of the input and of the three levels of the pyramid, and of the map from which the features are computed.
constexpr int kColours = 3, kFull = 8, kHalf = 16, kQuarter = 32, kMerged = 16;

// The arrays of weights in torch's shapes (outputs, inputs, rows, columns), in the order in which Python passes them.
// The bias of each layer follows its weights.
enum Weight {
    kFullFirst,
    kFullSecond = 2,
    kHalfFirst = 4,
    kHalfSecond = 6,
    kQuarterFirst = 8,
    kQuarterSecond = 10,
    kLateralHalf = 12,
    kLateralFull = 14,
    kReduce = 16,
    kOut = 18,
    kWeightCount = 20,
};

struct Sizes {
    int images, height, width;  // Of the input. Height and width are multiples of 4 * stride.
    int stride;                 // 1 or 2: the input is averaged over squares of this side first.
    int features;               // Channels of the result.

    int out_height() const { return height / stride; }
    int out_width() const { return width / stride; }
};

struct Shape {
    int outputs, inputs, side;

    std::size_t size() const { return static_cast<std::size_t>(outputs) * inputs * side * side; }
};

// The shape of an array of weights. A bias has one input and the side 1.
Shape weight_shape(const Sizes& sizes, int weight);

// The number of floats that the gradient needs for each image, besides images and weights.
std::size_t saved_size(const Sizes& sizes);

struct Execution {
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.
};

// Computes the features (images, out_height, out_width, features) of the images (images, 3, height, width). If `saved`
// is not null, writes there what the gradient needs: images * saved_size floats.
void forward(const Sizes& sizes, const float* const* weights, const float* images, const Execution& execution,
             float* features, float* saved);

// Computes the gradients of all weights from the gradient of the features and from forward()'s `saved`.
void backward(const Sizes& sizes, const float* const* weights, const float* saved, const float* grad_features,
              const Execution& execution, float* const* out);

}  // namespace fourd::encoder
