// Inner loops over the rows of a picture, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "similarity/similarity.h"

namespace fourd::similarity {

// The valid part of a picture consists of the pixels whose window is inside the picture. The valid part has kBorder
// fewer rows and columns than the picture.
constexpr int kBorder = kWindow - 1;

struct Window {
    float weights[kWindow];
};

// The pictures and the window, with sizes that are counted in floats. The channels of a pixel are adjacent in memory,
// so neighbouring pixels of a row, and the values that a window reads along the row, are `channels` floats apart.
struct Plan {
    Pictures pictures;
    Window window;
    std::size_t stride, valid;  // Number of floats in a row of a picture, and in a row of its valid part.
    int rows, valid_rows;
    float scale;  // 1 / (number of floats in the valid part).

    explicit Plan(const Pictures& pictures);
};

// Number of weighted means over the window of a pixel. With the picture p and the reference picture t (called truth),
// these are the means of p, t, p^2, t^2 and p * t.
constexpr int kMeans = 5;

// Number of derivatives of the similarity: with respect to the means of p, p^2 and p * t (see kMeans).
constexpr int kDerivatives = 3;

struct Loops {
    // Returns the sum of the similarities of one row of the valid part. If `derivatives` (kDerivatives, plan.valid) is
    // not null, the function also writes to it the derivatives of the similarities. `scratch` has 2 * kMeans rows, each
    // with plan.stride floats.
    double (*compare)(const Plan&, std::size_t row, float* scratch, float* derivatives);

    // Computes the gradient of a row of the picture from the derivatives of all windows that overlap the row.
    // `derivatives` (plan.valid_rows, kDerivatives, plan.valid) has the derivatives of all windows of the picture.
    // `scratch` has 2 rows, each with plan.stride + kBorder * channels floats.
    void (*gradient)(const Plan&, int row, const float* derivatives, float* scratch, float* out);
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::similarity
