// Updates of points and networks at the end of a training step. Every row is updated independently of the others, so
// the results do not depend on the number of threads. fourd/rendering/ops/moves.py documents the functions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sources/maths.h"

namespace fourd::moves {

// Indices into the arrays of N points.
struct Rows {
    const std::int64_t* at;
    std::size_t count;
    int threads;  // At least 1.
};

struct Betas {
    float first, second;
};

// Dense parameters of one array, with Adam's state.
struct Dense {
    float *parameter, *first, *second;
    const float* gradient;
    std::size_t size;
    float step_size;         // Learning rate, divided by the bias correction of the first moment.
    float root_correction;   // Root of the bias correction of the second moment.
};

void adam(const std::vector<Dense>& arrays, Betas betas, float epsilon, int threads);

// A parameter (N, columns) with its moments (N, columns), and the gradient (M, columns) of some rows.
struct Sparse {
    float *parameter, *first, *second;
    const float* gradient;
    const float* rates;  // Shape (M,) or, if is_constant, (1,).
    bool is_constant;
    int columns;
    float epsilon;
};

// Counts one step for the rows, and updates the rows of the parameters. Gradients that are NaN count as 0.
void adam_rows(const Rows& rows, float* steps, const std::vector<Sparse>& parameters, Betas betas);

struct Smoothing {
    const float* planes;   // Shape (N, 4).
    const float* spacing;  // Shape (N,).
    const float* rates;    // Shape (M,).
    float strength, tolerance, max_share;
};

void smooth(const Rows& rows, float* xyz, const Smoothing& smoothing);

struct Silhouette {
    sources::Pinhole camera;
    const float* matte;  // Shape (height, width).
    int width, height;
};

// `before` (M, 3) are the positions of the rows before they moved.
void keep_in_silhouettes(const Rows& rows, float* xyz, const float* before, const std::vector<Silhouette>& views);

// Undoes moves to depths below `near` along the unit vector `axis` from `centre`.
void keep_beyond(const Rows& rows, float* xyz, const float* before, const float* axis, const float* centre, float near);

// Adds the rows' gradient magnitudes, times their spacings, to `sum`, and 1 to `count` where they are not 0.
void add_magnitudes(const Rows& rows, const float* gradient, const float* spacing, float* sum, float* count);

}  // namespace fourd::moves
