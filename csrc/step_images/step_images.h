// The images of a training step: source views and ground truth from bytes, the pixels of a rendered image from its
// samples, and squared differences, with gradients. fourd/rendering/ops/step_images/reference.py has the same functions
// in plain torch. Callers check shapes, and arrays are dense.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/simd.h"

namespace fourd::step_images {

struct Execution {
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.
};

// One view in bytes: rgb has the shape (height, width, 3), and matte (height, width).
struct View {
    const std::uint8_t *rgb, *matte;
    int height, width;
};

// Writes a view in [0, 1] to the top left corner of an image (3, height, width) and a matte (height, width), and zeros
// to the rest of them. `out_images` and `out_mattes` have one image and one matte for each view.
void convert_views(const View* views, int count, int height, int width, const Execution& execution, float* out_images,
                   float* out_mattes);

// Writes the matte in [0, 1], and the colours in [0, 1] (height, width, 3), multiplied by the matte.
void premultiply(const View& view, const Execution& execution, float* out_rgb, float* out_matte);

// An image of height x width pixels, of which each is the mean of samples x samples samples.
struct Grid {
    int height, width, samples;
};

// Rendered samples: features (samples * height, samples * width, 4), of which the first three are the colour, and alpha
// of the same size.
struct Samples {
    const float *features, *alpha;
};

// Means over the samples of each pixel: the colours (height, width, 3), the last feature (height, width), and
// `prediction`: the colours on a background colour, which has the weight 1 - alpha.
struct Pixels {
    float *colour, *last, *prediction;
};

void resolve(const Grid& grid, const Samples& samples, const float background[3], const Execution& execution,
             const Pixels& out);

// Gradients with respect to Pixels. Each may be null for zeros.
struct PixelGradients {
    const float *colour, *last, *prediction;
};

// Computes the gradients of the samples, in their shapes.
void resolve_backward(const Grid& grid, const PixelGradients& gradients, const float background[3],
                      const Execution& execution, float* out_features, float* out_alpha);

// Adds a background to colours (count, 3): rgb + (1 - alpha) * background.
void add_background(std::size_t count, const float* rgb, const float* alpha, const float background[3],
                    const Execution& execution, float* out);

// Rows of `columns` numbers, of which those before `first` do not count.
struct Table {
    std::size_t rows;
    int columns, first;
};

// Returns the mean of the squared differences of two tables. `truth` may be null for zeros. With `clamps`, values are
// clamped to [0, 1] before they are compared. If `gradient` is not null, writes the gradient of the values there, for the
// gradient `upstream` of the mean. This does not support clamping.
double mean_square(const Table& table, const float* values, const float* truth, bool clamps, const Execution& execution,
                   float upstream, float* gradient);

}  // namespace fourd::step_images
