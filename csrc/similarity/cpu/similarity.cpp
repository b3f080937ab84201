#include "similarity/similarity.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "common/buffer.h"
#include "common/eight.h"
#include "common/inline.h"
#include "common/team.h"

namespace fourd::similarity {
namespace {

constexpr double kSigma = 1.5;
constexpr float kLuminance = 0.01f * 0.01f, kContrast = 0.03f * 0.03f;
constexpr int kReach = kWindow - 1;   // rows and columns that a valid picture loses
constexpr int kRowsPerTask = 16;
constexpr int kLanes = 8;             // of sums, so that they need not wait for one another

using Window = std::array<float, kWindow>;

Window gaussian() {
    double weights[kWindow], total = 0;
    for (int k = 0; k < kWindow; ++k) {
        const double offset = k - kReach / 2;
        weights[k] = std::exp(-offset * offset / (2 * kSigma * kSigma));
        total += weights[k];
    }
    Window out{};
    for (int k = 0; k < kWindow; ++k) out[k] = static_cast<float>(weights[k] / total);
    return out;
}

// Sizes in floats: a row of channels side by side is a plain array, whose window steps by channels.
struct Plan {
    Pictures pictures;
    Window window;
    std::size_t stride, valid;  // of a row of the pictures, and of their valid part
    int rows, valid_rows;
    float scale;                // 1 over the number of valid values

    explicit Plan(const Pictures& of)
        : pictures(of), window(gaussian()), stride(static_cast<std::size_t>(of.width) * of.channels),
          valid(static_cast<std::size_t>(of.width - kReach) * of.channels), rows(of.height),
          valid_rows(of.height - kReach), scale(1.0f / (static_cast<float>(valid) * static_cast<float>(valid_rows))) {}
};

// The window's means at a row: of the picture, the truth, their squares and their product.
constexpr int kMeans = 5;

// What the similarity's sum changes by as the picture's mean, mean square and mean product do.
constexpr int kSlopes = 3;

// Down the columns, i and, for eight numbers, those after it; out has kMeans rows of stride.
template <typename Number>
FOURD_INLINE void down_at(const Plan& plan, const float* picture, const float* truth, std::size_t i, float* out) {
    const std::size_t stride = plan.stride;
    Number mean_x{}, mean_y{}, square_x{}, square_y{}, product{};
    for (int k = 0; k < kWindow; ++k) {
        Number x, y;
        load(picture + k * stride + i, &x);
        load(truth + k * stride + i, &y);
        const Number wx = plan.window[k] * x, wy = plan.window[k] * y;
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

// The window's sum at from, which steps by step.
template <typename Number>
FOURD_INLINE void window_at(const Window& window, int first, int last, const float* from, std::ptrdiff_t step,
                            float* to) {
    Number sum{};
    for (int k = first; k < last; ++k) {
        Number value;
        load(from + k * step, &value);
        sum += window[k] * value;
    }
    store(&sum, to);
}

// Along a row: count values, each from kWindow that lie step apart.
FOURD_INLINE void along(const Window& window, const float* from, std::size_t count, std::size_t step, float* to) {
    in_eights(count, [&](std::size_t i, auto* number) FOURD_ALWAYS {
        window_at<NumberOf<decltype(number)>>(window, 0, kWindow, from + i, static_cast<std::ptrdiff_t>(step), to + i);
    });
}

// A row's similarities from its means (rows of stride), and where wanted its slopes (kSlopes rows of valid).
template <bool kWithSlopes>
FOURD_INLINE void compare(const Plan& plan, const float* means, float* FOURD_ALONE values, float* FOURD_ALONE slopes) {
    const std::size_t stride = plan.stride, valid = plan.valid;
    const float *FOURD_ALONE mean_x = means, *FOURD_ALONE mean_y = means + stride;
    const float *FOURD_ALONE square_x = means + 2 * stride, *FOURD_ALONE square_y = means + 3 * stride;
    const float* FOURD_ALONE product = means + 4 * stride;
    for (std::size_t i = 0; i < valid; ++i) {
        const float x = mean_x[i], y = mean_y[i];
        const float luminance_up = 2 * x * y + kLuminance, luminance_down = x * x + y * y + kLuminance;
        const float contrast_up = 2 * (product[i] - x * y) + kContrast;
        const float contrast_down = (square_x[i] - x * x) + (square_y[i] - y * y) + kContrast;
        const float share = 1.0f / (luminance_down * contrast_down);
        const float value = luminance_up * contrast_up * share;
        values[i] = value;
        if (!kWithSlopes) continue;
        const float per_luminance = contrast_down * share, per_contrast = luminance_down * share;
        slopes[i] = 2 * y * (contrast_up - luminance_up) * share + 2 * x * value * (per_contrast - per_luminance);
        slopes[valid + i] = -value * per_contrast;
        slopes[2 * valid + i] = 2 * luminance_up * share;
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

// Valid row: its sum of similarities, and where wanted its slopes. scratch has 2 * kMeans rows of stride.
FOURD_INLINE double compare_row(const Plan& plan, std::size_t row, float* scratch, float* slopes) {
    float* means = scratch + kMeans * plan.stride;
    const float* picture = plan.pictures.picture + row * plan.stride;
    const float* truth = plan.pictures.truth + row * plan.stride;
    in_eights(plan.stride, [&](std::size_t i, auto* number) FOURD_ALWAYS {
        down_at<NumberOf<decltype(number)>>(plan, picture, truth, i, scratch);
    });
    for (int mean = 0; mean < kMeans; ++mean) {
        along(plan.window, scratch + mean * plan.stride, plan.valid, plan.pictures.channels, means + mean * plan.stride);
    }
    if (slopes) {
        compare<true>(plan, means, scratch, slopes);
    } else {
        compare<false>(plan, means, scratch, slopes);
    }
    return sum_of(scratch, plan.valid);
}

// Row of the picture: its gradient, from the slopes of all windows that hold it. scratch has 2 rows of
// stride + kReach * channels.
FOURD_INLINE void gradient_row(const Plan& plan, int row, const float* slopes, float* scratch,
                               float* FOURD_ALONE out) {
    const std::size_t stride = plan.stride, valid = plan.valid;
    const std::size_t border = static_cast<std::size_t>(kReach) * plan.pictures.channels;
    const float* x = plan.pictures.picture + row * stride;
    const float* y = plan.pictures.truth + row * stride;
    float *padded = scratch, *spread = scratch + stride + border;
    for (int slope = 0; slope < kSlopes; ++slope) {
        // Nothing beyond the valid part: a window's weights end there. They are symmetric.
        std::fill_n(padded, border, 0.0f);
        std::fill_n(padded + stride, border, 0.0f);
        const int first = std::max(0, row - plan.valid_rows + 1), last = std::min(kWindow, row + 1);
        const std::ptrdiff_t step = static_cast<std::ptrdiff_t>(kSlopes * valid);
        const float* from = slopes + row * step + static_cast<std::ptrdiff_t>(slope * valid);
        in_eights(valid, [&](std::size_t i, auto* number) FOURD_ALWAYS {
            window_at<NumberOf<decltype(number)>>(plan.window, first, last, from + i, -step, padded + border + i);
        });
        along(plan.window, padded, stride, plan.pictures.channels, spread);
        if (slope == 0) {
            for (std::size_t i = 0; i < stride; ++i) out[i] = plan.scale * spread[i];
        } else {
            const float factor = slope == 1 ? 2 * plan.scale : plan.scale;
            const float* FOURD_ALONE by = slope == 1 ? x : y;
            for (std::size_t i = 0; i < stride; ++i) out[i] += factor * by[i] * spread[i];
        }
    }
}

struct Loops {
    double (*compare)(const Plan&, std::size_t, float*, float*);
    void (*gradient)(const Plan&, int, const float*, float*, float*);
};

#define FOURD_LOOPS(NAME, TARGET)                                                                      \
    TARGET double compare_##NAME(const Plan& plan, std::size_t row, float* scratch, float* slopes) {   \
        return compare_row(plan, row, scratch, slopes);                                                \
    }                                                                                                  \
    TARGET void gradient_##NAME(const Plan& plan, int row, const float* slopes, float* scratch, float* out) { \
        gradient_row(plan, row, slopes, scratch, out);                                                 \
    }                                                                                                  \
    constexpr Loops loops_##NAME = {compare_##NAME, gradient_##NAME};

FOURD_LOOPS(baseline, )
#if defined(FOURD_X86) && defined(__GNUC__)
FOURD_LOOPS(avx2, __attribute__((target("avx2,fma"))))
#endif

Loops loops_for(Simd simd) {
#if defined(FOURD_X86) && defined(__GNUC__)
    if (simd != Simd::baseline) return loops_avx2;
#endif
    (void)simd;
    return loops_baseline;
}

// Calls work(row, worker) for each of the rows.
template <typename Work>
void for_rows(Team& team, int rows, const Work& work) {
    team.run((rows + kRowsPerTask - 1) / kRowsPerTask, [&](int task, int worker) {
        for (int row = task * kRowsPerTask; row < std::min(rows, (task + 1) * kRowsPerTask); ++row) work(row, worker);
    });
}

}  // namespace

double similarity(const Pictures& pictures, float* gradient) {
    const Plan plan(pictures);
    const Loops loops = loops_for(pictures.simd);
    Team team(pictures.threads);
    const std::size_t border = static_cast<std::size_t>(kReach) * pictures.channels;
    std::vector<Buffer<float>> scratch(team.size());
    for (Buffer<float>& one : scratch) one.require(2 * kMeans * plan.stride + 2 * border);
    Buffer<float> slopes;
    if (gradient) slopes.require(kSlopes * plan.valid * plan.valid_rows);
    std::vector<double> sums(plan.valid_rows);
    for_rows(team, plan.valid_rows, [&](int row, int worker) {
        float* const to = gradient ? slopes.data() + kSlopes * plan.valid * row : nullptr;
        sums[row] = loops.compare(plan, row, scratch[worker].data(), to);
    });
    if (gradient) {
        for_rows(team, plan.rows, [&](int row, int worker) {
            loops.gradient(plan, row, slopes.data(), scratch[worker].data(), gradient + row * plan.stride);
        });
    }
    double total = 0;
    for (const double sum : sums) total += sum;  // in order, whoever made them
    return total / (static_cast<double>(plan.valid) * plan.valid_rows);
}

}  // namespace fourd::similarity
