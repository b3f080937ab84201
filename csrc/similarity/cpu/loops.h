// The inner loops over rows, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "similarity/similarity.h"

namespace fourd::similarity {

constexpr int kBorder = kWindow - 1;  // rows and columns that the valid part lacks

struct Window {
    float weights[kWindow];
};

// Sizes in floats: a row of interleaved channels is a plain array, and the window's step is the number of channels.
struct Plan {
    Pictures pictures;
    Window window;
    std::size_t stride, valid;  // of a row of the pictures, and of their valid part
    int rows, valid_rows;
    float scale;  // 1 / number of valid values

    explicit Plan(const Pictures& pictures);
};

// Window means at a row: of the picture, the truth, their squares and their product.
constexpr int kMeans = 5;

// Derivatives of the similarity with respect to the picture's mean, mean square and mean product.
constexpr int kDerivatives = 3;

struct Loops {
    // A valid row: returns its sum of similarities, and writes its derivatives unless null. scratch has 2 * kMeans rows
    // of stride.
    double (*compare)(const Plan&, std::size_t row, float* scratch, float* derivatives);

    // A row of the picture: its gradient, from the derivatives of all windows that contain it. scratch has 2 rows of
    // stride + kBorder * channels.
    void (*gradient)(const Plan&, int row, const float* derivatives, float* scratch, float* out);
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::similarity
