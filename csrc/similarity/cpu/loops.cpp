// Computes window means along rows and columns, and from these means the similarities and their derivatives. The loops
// are written so that compilers vectorise them.
#include "similarity/cpu/loops.h"

#include <cstddef>
#include <cstring>

#include "common/eight.h"
#include "common/inline.h"

namespace fourd::similarity::FOURD_SIMD {
namespace {

constexpr float kLuminance = 0.01f * 0.01f, kContrast = 0.03f * 0.03f;
// Number of partial sums. A processor can do the additions to different partial sums in parallel, because they are
// independent.
constexpr int kLanes = 8;

// Computes the weighted means (listed at kMeans) over a column of kWindow elements: element i of the current row and of
// the rows below it. If Number is Eight, the function also computes the means for the next seven columns. `out` has
// kMeans rows, each with plan.stride floats.
template <typename Number>
FOURD_INLINE void column_means_at(const Plan& plan, const float* picture, const float* truth, std::size_t i,
                                  float* out) {
    const std::size_t stride = plan.stride;
    Number mean_x{}, mean_y{}, square_x{}, square_y{}, product{};
    for (int k = 0; k < kWindow; ++k) {
        Number x, y;
        load(picture + k * stride + i, &x);
        load(truth + k * stride + i, &y);
        const Number wx = plan.window.weights[k] * x, wy = plan.window.weights[k] * y;
        mean_x += wx;
        mean_y += wy;
        square_x += wx * x;
        square_y += wy * y;
        product += wx * y;
    }
    store(&mean_x, out + i);
    store(&mean_y, out + stride + i);
    store(&square_x, out + 2 * stride + i);
    store(&square_y, out + 3 * stride + i);
    store(&product, out + 4 * stride + i);
}

// Computes the weighted sum over the elements [first, last) of a window. Consecutive elements are `step` floats apart.
template <typename Number>
FOURD_INLINE void window_sum_at(const Window& window, int first, int last, const float* from, std::ptrdiff_t step,
                                float* to) {
    Number sum{};
    for (int k = first; k < last; ++k) {
        Number value;
        load(from + k * step, &value);
        sum += window.weights[k] * value;
    }
    store(&sum, to);
}

// Computes `count` window means along a row. A window mean is the weighted mean of kWindow values that are `step`
// floats apart.
FOURD_INLINE void row_means(const Window& window, const float* from, std::size_t count, std::size_t step, float* to) {
    for_eights(count, [&](std::size_t i, auto* number) FOURD_INLINE_LAMBDA {
        window_sum_at<NumberOf<decltype(number)>>(window, 0, kWindow, from + i, static_cast<std::ptrdiff_t>(step),
                                                  to + i);
    });
}

// Computes the similarities of a row from its window means. `means` has kMeans rows, each with plan.stride floats. If
// kWithDerivatives is true, the function also writes `derivatives`: kDerivatives rows, each with plan.valid floats.
template <bool kWithDerivatives>
FOURD_INLINE void compare(const Plan& plan, const float* means, float* FOURD_RESTRICT values,
                          float* FOURD_RESTRICT derivatives) {
    const std::size_t stride = plan.stride, valid = plan.valid;
    const float *FOURD_RESTRICT mean_x = means, *FOURD_RESTRICT mean_y = means + stride;
    const float *FOURD_RESTRICT square_x = means + 2 * stride, *FOURD_RESTRICT square_y = means + 3 * stride;
    const float* FOURD_RESTRICT product = means + 4 * stride;
    for (std::size_t i = 0; i < valid; ++i) {
        const float x = mean_x[i], y = mean_y[i];
        const float luminance_up = 2 * x * y + kLuminance, luminance_down = x * x + y * y + kLuminance;
        const float contrast_up = 2 * (product[i] - x * y) + kContrast;
        const float contrast_down = (square_x[i] - x * x) + (square_y[i] - y * y) + kContrast;
        const float inverse = 1.0f / (luminance_down * contrast_down);
        const float value = luminance_up * contrast_up * inverse;
        values[i] = value;
        if (!kWithDerivatives) continue;
        const float per_luminance = contrast_down * inverse, per_contrast = luminance_down * inverse;
        derivatives[i] =
            2 * y * (contrast_up - luminance_up) * inverse + 2 * x * value * (per_contrast - per_luminance);
        derivatives[valid + i] = -value * per_contrast;
        derivatives[2 * valid + i] = 2 * luminance_up * inverse;
    }
}

FOURD_INLINE double sum_of(const float* values, std::size_t count) {
    double sums[kLanes] = {}, total = 0;
    std::size_t i = 0;
    for (; i + kLanes <= count; i += kLanes) {
        for (int lane = 0; lane < kLanes; ++lane) sums[lane] += values[i + lane];
    }
    for (; i < count; ++i) total += values[i];
    for (const double sum : sums) total += sum;
    return total;
}

double compare_row(const Plan& plan, std::size_t row, float* scratch, float* derivatives) {
    float* means = scratch + kMeans * plan.stride;
    const float* picture = plan.pictures.picture + row * plan.stride;
    const float* truth = plan.pictures.truth + row * plan.stride;
    for_eights(plan.stride, [&](std::size_t i, auto* number) FOURD_INLINE_LAMBDA {
        column_means_at<NumberOf<decltype(number)>>(plan, picture, truth, i, scratch);
    });
    for (int mean = 0; mean < kMeans; ++mean) {
        row_means(plan.window, scratch + mean * plan.stride, plan.valid, plan.pictures.channels,
                  means + mean * plan.stride);
    }
    if (derivatives) {
        compare<true>(plan, means, scratch, derivatives);
    } else {
        compare<false>(plan, means, scratch, derivatives);
    }
    return sum_of(scratch, plan.valid);
}

void gradient_row(const Plan& plan, int row, const float* derivatives, float* scratch, float* FOURD_RESTRICT out) {
    const std::size_t stride = plan.stride, valid = plan.valid;
    const std::size_t border = static_cast<std::size_t>(kBorder) * plan.pictures.channels;
    const float* x = plan.pictures.picture + row * stride;
    const float* y = plan.pictures.truth + row * stride;
    float *padded = scratch, *smoothed = scratch + stride + border;
    for (int derivative = 0; derivative < kDerivatives; ++derivative) {
        // The derivatives are padded with zeros outside the valid part. The backward pass correlates the derivatives
        // with the reversed window. The window is symmetric, so the reversed window has the same weights.
        std::memset(padded, 0, border * sizeof(float));
        std::memset(padded + stride, 0, border * sizeof(float));
        const int first = row < plan.valid_rows ? 0 : row - plan.valid_rows + 1;
        const int last = row + 1 < kWindow ? row + 1 : kWindow;
        const std::ptrdiff_t step = static_cast<std::ptrdiff_t>(kDerivatives * valid);
        const float* from = derivatives + row * step + static_cast<std::ptrdiff_t>(derivative * valid);
        for_eights(valid, [&](std::size_t i, auto* number) FOURD_INLINE_LAMBDA {
            window_sum_at<NumberOf<decltype(number)>>(plan.window, first, last, from + i, -step, padded + border + i);
        });
        row_means(plan.window, padded, stride, plan.pictures.channels, smoothed);
        if (derivative == 0) {
            for (std::size_t i = 0; i < stride; ++i) out[i] = plan.scale * smoothed[i];
        } else {
            const float factor = derivative == 1 ? 2 * plan.scale : plan.scale;
            const float* FOURD_RESTRICT by = derivative == 1 ? x : y;
            for (std::size_t i = 0; i < stride; ++i) out[i] += factor * by[i] * smoothed[i];
        }
    }
}

}  // namespace

const Loops loops = {compare_row, gradient_row};

}  // namespace fourd::similarity::FOURD_SIMD
