// Inner loops over batches of consecutive points, compiled once for each instruction set.
#pragma once

#include <cstddef>

#include "blend/blend.h"
#include "common/dispatch.h"

namespace fourd::blend {

constexpr int kLanes = 16;
constexpr int kRun = 64;  // Number of points per batch. Vector instructions process the points of a batch together.

// The sums over the points of one task, for the gradient of the MLP. Each sum is stored as kLanes partial sums.
struct Sums {
    float* weight;  // Shape (channels, hidden, kLanes).
    float* out;     // Shape (hidden, kLanes).
    float* bias;    // Shape (kLanes,).
};

struct Loops {
    // Computes the logits of points [first, first + count) in all views. `count` is at most kRun.
    void (*forward)(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, float* logits);

    // Writes the gradients of Inputs::point and Inputs::samples. Adds the gradient of the MLP to `sums`.
    void (*backward)(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, const float* logits,
                     const float* gradient, const Gradients& out, const Sums& sums);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::blend
