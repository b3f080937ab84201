// Loops over blocks of consecutive points, compiled once for each instruction set.
#pragma once

#include <cstddef>

#include "common/dispatch.h"
#include "heads/heads.h"

namespace fourd::heads {

constexpr int kBlock = 64;  // Points per block.

// The part of the first layers that time planes contribute, along one axis of space. It is linear between knots, the
// samples of all planes along the axis, so a point needs only the values at two knots. At a knot, the value is the
// product of the planes' features and the layers' weights.
struct AxisTable {
    const float* values;     // Shape (knots, 3 * hidden).
    const float* positions;  // Shape (knots,), ascending from -1 to 1.
    const float* scales;     // Shape (knots - 1,): 1 over the distance to the next knot.
    const int* starts;       // Shape (kBuckets,): the last knot at or before the start of each equal part of [-1, 1].
    int knots;
    std::size_t first;       // Index of the table's first knot among those of all axes.
};

constexpr int kBuckets = 512;

// The weights in the layouts that the loops read. Rows are padded with zeros to strides that are multiples of kPad.
// "Rows" are the arrays of torch (outputs, inputs), which the gradient reads. "Columns" are their transposes, which the
// forward pass reads. The arrays of the three first layers are below each other, geometry, blend and SH.
struct Packed {
    float *first, *first_columns, *first_bias;     // Shapes (3 * hidden, features), (features, 3 * hidden).
    float *second, *second_columns, *second_bias;  // Shapes (hidden, hidden).
    float *last, *last_bias;                       // Shape (2, hidden).
    float *image, *image_columns;                  // Shapes (hidden, channels) and (channels, hidden).
    float *out, *out_bias;                         // Shapes (hidden,) and (1,).
    float *sh, *sh_columns, *sh_bias;              // Shapes (kSh, hidden) and (hidden, kSh).
};

// Sums of the gradient of the weights over some points, in the layouts of Packed with the same names.
struct Sums {
    float *first_columns, *first_bias, *second, *second_bias, *last, *last_bias, *image_columns, *out, *out_bias, *sh,
        *sh_bias, *tables;  // The tables have the shape (knots of all axes, 3 * hidden).
};

// Memory for one block. Rows have the strides of Packed.
struct Workspace {
    float* grad_first;   // Shape (kBlock, 3 * hidden).
    float* back;         // Shape (kBlock, hidden).
    float* wide;         // Shape (kBlock, features) or (kBlock, channels), whichever is larger.
    float* grad_last;    // Shape (2, kBlock).
    float* grad_sh;      // Shape (kBlock, kSh).
    float* grad_logits;  // Shape (views, kBlock).
    float* weights;      // Shape (views, kBlock).
    float* grad_mixed;   // Shape (views, 3, kBlock).
    float* basis;        // Shape (kBlock, kShTerms).
    float* grad_colour;  // Shape (3, kBlock).
    float* tanhs;        // Shape (3, kBlock).
};

struct Job {
    const Sizes* sizes;
    const Settings* settings;
    const Packed* packed;
    const Inputs* inputs;
    const AxisTable* tables;  // Shape (3,), or null without time planes.
};

// Row-major matrices a (rows, depth), or (depth, rows) if it is transposed, and b (depth, columns). The number of
// columns of b is a multiple of kPad.
struct Factors {
    const float *a, *b;
    int rows, depth, columns, a_step;
    bool is_transposed;
};

struct Loops {
    // Computes the points [first, first + count), with count at most kBlock.
    void (*forward)(const Job& job, const Workspace& space, std::size_t first, int count, const Outputs& out);

    // Writes the gradients of the inputs of the same points, and adds the gradient of the weights to `sums`.
    void (*backward)(const Job& job, const Workspace& space, std::size_t first, int count, const Saved& saved,
                     const Upstream& upstream, const Gradients& out, const Sums& sums);

    // Writes the product a * b to `to` (rows, columns).
    void (*multiply)(const Factors& factors, float* to);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::heads
