// Loops over the pixels of a row, compiled once for each instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"
#include "step_images/step_images.h"

namespace fourd::step_images {

// The gradient of a mean square is (scale * difference) * upstream, in this order.
struct Factors {
    float scale, upstream;
};

struct Loops {
    // Converts `width` pixels to three planes that are `plane` floats apart, and their matte.
    void (*convert_row)(const std::uint8_t* rgb, const std::uint8_t* matte, int width, float* out,
                        std::size_t plane, float* out_matte);
    void (*premultiply_row)(const std::uint8_t* rgb, const std::uint8_t* matte, int width, float* out,
                            float* out_matte);
    // Computes row `y` of the image.
    void (*resolve_row)(const Grid& grid, const Samples& samples, const float* background, int y, const Pixels& out);
    // Computes all rows of samples of row `y` of the image.
    void (*resolve_row_backward)(const Grid& grid, const PixelGradients& gradients, const float* background, int y,
                                 float* out_features, float* out_alpha);
    void (*add_background)(std::size_t count, const float* rgb, const float* alpha, const float* background,
                           float* out);
    // Returns the sum of squared differences. Writes the differences times both factors, and zeros in columns that do
    // not count, to `gradient` if it is not null.
    double (*sum_squares)(const Table& table, const float* values, const float* truth, bool clamps,
                          const Factors& factors, float* gradient);
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::step_images
