// Computes the logits for blending source views with a small MLP. The logit of a point in a view is
//     range * tanh((out . relu(point + weight^T sample) + bias) / range).
// Inputs::point is the contribution to the hidden layer that is the same in all views, and `sample` holds the channels
// that were sampled from the view for this point. The other symbols are members of Mlp. The kernel never stores the
// hidden layer for all views and points at once. Callers check shapes, and arrays are dense.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::blend {

constexpr int kMaxHidden = 256;
constexpr int kMaxChannels = 64;

struct Mlp {
    const float* weight;  // Shape (channels, hidden): weights from the samples to the hidden layer.
    const float* out;     // Shape (hidden,): weights from the hidden layer to the logit.
    float bias;
    float range;   // All logits are between -range and range.
    int channels;  // From 1 to kMaxChannels.
    int hidden;    // From 1 to kMaxHidden.
};

struct Inputs {
    const float* point;    // Shape (count, hidden): each point's contribution to the hidden layer.
    const float* samples;  // Shape (views, channels, count): channels of each point in each view.
    std::size_t count;
    std::size_t views;
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.
};

// Gradients of the loss with respect to the members of Inputs and Mlp with the same names, in the same shapes.
struct Gradients {
    float* point;
    float* samples;
    float* weight;
    float* out;
    float* bias;  // Shape (1,).
};

// Writes the logits to `logits` (views, count).
void logits(const Mlp& mlp, const Inputs& inputs, float* logits);

// Computes the gradients of logits(). `logits` (views, count) is the output of logits(), and `gradient` (views, count)
// is the gradient of the loss with respect to this output.
void logits_backward(const Mlp& mlp, const Inputs& inputs, const float* logits, const float* gradient,
                     const Gradients& out);

}  // namespace fourd::blend
