// Computes, with a small MLP, the logits for blending source views: range * tanh((out . relu(point + weight * sample) +
// bias) / range). The kernel never stores the hidden layer of all views and points. Callers check shapes, and arrays
// are dense.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::blend {

constexpr int kMaxHidden = 256;
constexpr int kMaxChannels = 64;

struct Mlp {
    const float* weight;  // (channels, hidden): weights of the hidden layer for the samples
    const float* out;     // (hidden,)
    float bias;
    float range;   // logits are between -range and range
    int channels;  // 1 to kMaxChannels
    int hidden;    // 1 to kMaxHidden
};

struct Inputs {
    const float* point;    // (count, hidden): the point's contribution to the hidden layer
    const float* samples;  // (views, channels, count)
    std::size_t count;
    std::size_t views;
    int threads;  // at least 1; does not change the result
    Simd simd;    // an instruction set that this machine supports
};

struct Gradients {
    float* point;  // same shape as in Inputs
    float* samples;
    float* weight;  // same shape as in Mlp
    float* out;
    float* bias;  // a single number
};

// Writes the logits (views, count).
void logits(const Mlp& mlp, const Inputs& inputs, float* logits);

// logits is the output of logits(). gradient (views, count) is the gradient with respect to the logits.
void logits_backward(const Mlp& mlp, const Inputs& inputs, const float* logits, const float* gradient,
                     const Gradients& out);

}  // namespace fourd::blend
