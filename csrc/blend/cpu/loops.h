// Inner loops over batches of consecutive points, compiled once for each instruction set.
#pragma once

#include <cstddef>

#include "blend/blend.h"
#include "common/dispatch.h"

namespace fourd::blend {

constexpr int kLanes = 16;
constexpr int kRun = 64;  // points per batch, processed together as vectors

// Sums of one task for the gradient of the MLP. Each sum consists of kLanes partial sums.
struct Sums {
    float* weight;  // (channels, hidden, kLanes)
    float* out;     // (hidden, kLanes)
    float* bias;    // (kLanes,)
};

struct Loops {
    // Computes the logits of points [first, first + count) in all views. count is at most kRun.
    void (*forward)(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, float* logits);

    // Writes the gradients of Inputs::point and Inputs::samples, and adds the gradient of the MLP to sums.
    void (*backward)(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, const float* logits,
                     const float* gradient, const Gradients& out, const Sums& sums);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::blend
