// Logits of source views by a small MLP: range * tanh((out . relu(point + weight * sample) + bias) / range).
// Nothing as large as views x points x hidden is ever stored. Callers check shapes; arrays are dense.
#pragma once

#include <cstddef>

#include "common/simd.h"

namespace fourd::blend {

constexpr int kMostHidden = 256;
constexpr int kMostChannels = 64;

struct Mlp {
    const float* weight;  // (channels, hidden): of the hidden layer, for the sample
    const float* out;     // (hidden,)
    float bias;
    float range;   // logits lie within plus and minus this
    int channels;  // 1 to kMostChannels
    int hidden;    // 1 to kMostHidden
};

struct Inputs {
    const float* point;    // (count, hidden): what the point alone gives to the hidden layer
    const float* samples;  // (views, channels, count)
    std::size_t count;
    std::size_t views;
    int threads;  // at least 1; the result does not depend on it
    Simd simd;    // one that this machine runs
};

struct Gradients {
    float* point;    // like Inputs' arrays
    float* samples;
    float* weight;   // like Mlp's
    float* out;
    float* bias;     // one number
};

// logits (views, count)
void logits(const Mlp& mlp, const Inputs& inputs, float* logits);

// logits are what the function above gave, gradient (views, count) theirs.
void logits_backward(const Mlp& mlp, const Inputs& inputs, const float* logits, const float* gradient,
                     const Gradients& out);

}  // namespace fourd::blend
