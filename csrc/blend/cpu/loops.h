// The inner loops over runs of points, compiled once for each instruction set.
#pragma once

#include <cstddef>

#include "blend/blend.h"
#include "common/dispatch.h"

namespace fourd::blend {

constexpr int kLanes = 16;
constexpr int kRun = 64;  // points processed together, as vectors

// A task's sums for the MLP's gradient, each in kLanes parts.
struct Sums {
    float* weight;  // (channels, hidden, kLanes)
    float* out;     // (hidden, kLanes)
    float* bias;    // (kLanes,)
};

struct Loops {
    // Logits of points first to first + count (at most kRun) in all views.
    void (*forward)(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, float* logits);

    // Writes the gradients of point and samples, and adds to sums.
    void (*backward)(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, const float* logits,
                     const float* gradient, const Gradients& out, const Sums& sums);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::blend
