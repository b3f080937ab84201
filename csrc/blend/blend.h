// Blend logits of source views by a small MLP: range * tanh((out . relu(point + weight * sample) + bias) / range). The
// kernel never stores an array of views x points x hidden numbers. Callers check shapes, and arrays are dense.
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
    float range;   // bound of the absolute logits
    int channels;  // 1 to kMaxChannels
    int hidden;    // 1 to kMaxHidden
};

struct Inputs {
    const float* point;    // (count, hidden): the point's contribution to the hidden layer
    const float* samples;  // (views, channels, count)
    std::size_t count;
    std::size_t views;
    int threads;  // at least 1; the result does not depend on it
    Simd simd;    // an instruction set that this machine supports
};

struct Gradients {
    float* point;  // shaped as in Inputs
    float* samples;
    float* weight;  // shaped as in Mlp
    float* out;
    float* bias;  // one value
};

// logits (views, count)
void logits(const Mlp& mlp, const Inputs& inputs, float* logits);

// logits is the output of logits(). gradient (views, count) is the gradient with respect to the logits.
void logits_backward(const Mlp& mlp, const Inputs& inputs, const float* logits, const float* gradient,
                     const Gradients& out);

}  // namespace fourd::blend
