// The inner loops over rows, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "similarity/similarity.h"

namespace fourd::similarity {

constexpr int kReach = kWindow - 1;  // rows and columns that a valid picture loses

struct Window {
    float weights[kWindow];
};

// Sizes in floats: a row of channels side by side is a plain array, whose window steps by channels.
struct Plan {
    Pictures pictures;
    Window window;
    std::size_t stride, valid;  // of a row of the pictures, and of their valid part
    int rows, valid_rows;
    float scale;                // 1 over the number of valid values

    explicit Plan(const Pictures& pictures);
};

// The window's means at a row: of the picture, the truth, their squares and their product.
constexpr int kMeans = 5;

// What the similarity's sum changes by as the picture's mean, mean square and mean product do.
constexpr int kSlopes = 3;

struct Loops {
    // Valid row: its sum of similarities, and its slopes unless null. scratch has 2 * kMeans rows of stride.
    double (*compare)(const Plan&, std::size_t row, float* scratch, float* slopes);

    // Row of the picture: its gradient, from the slopes of all windows that hold it. scratch has 2 rows of
    // stride + kReach * channels.
    void (*gradient)(const Plan&, int row, const float* slopes, float* scratch, float* out);
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::similarity
