// Loops over blocks of consecutive points, compiled once for each instruction set.
#pragma once

#include <cstddef>

#include "common/dispatch.h"
#include "heads/heads.h"

namespace fourd::heads {

constexpr int kBlock = 64;  // Points per block.

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
        *sh_bias;
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
    float* basis;        // Shape (kShTerms, kBlock).
    float* grad_colour;  // Shape (3, kBlock).
    float* tanhs;        // Shape (3, kBlock).
};

struct Job {
    const Sizes* sizes;
    const Settings* settings;
    const Packed* packed;
    const Inputs* inputs;
};

struct Loops {
    // Computes the points [first, first + count), with count at most kBlock.
    void (*forward)(const Job& job, const Workspace& space, std::size_t first, int count, const Outputs& out);

    // Writes the gradients of the inputs of the same points, and adds the gradient of the weights to `sums`.
    void (*backward)(const Job& job, const Workspace& space, std::size_t first, int count, const Saved& saved,
                     const Upstream& upstream, const Gradients& out, const Sums& sums);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::heads
