// Blend logits of source views by a small MLP: range * tanh((out . relu(point + weight * sample) + bias) / range).
// Never stores an array as large as views x points x hidden. Callers check shapes; arrays are dense.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::blend {

constexpr int kMaxHidden = 256;
constexpr int kMaxChannels = 64;

struct Mlp {
    const float* weight;  // (channels, hidden): hidden layer, for the sample
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
    Simd simd;    // one that this machine runs
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

// logits are the output of logits(), gradient (views, count) is with respect to them.
void logits_backward(const Mlp& mlp, const Inputs& inputs, const float* logits, const float* gradient,
                     const Gradients& out);

}  // namespace fourd::blend
