#include "similarity/similarity.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "common/buffer.h"
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

// Down the columns; out has kMeans rows of stride.
FOURD_INLINE void down(const Plan& plan, std::size_t row, float* out) {
    const std::size_t stride = plan.stride;
    float *mean_x = out, *mean_y = out + stride, *square_x = out + 2 * stride, *square_y = out + 3 * stride;
    float* product = out + 4 * stride;
    std::fill_n(out, kMeans * stride, 0.0f);
    for (int k = 0; k < kWindow; ++k) {
        const float* x = plan.pictures.picture + (row + k) * stride;
        const float* y = plan.pictures.truth + (row + k) * stride;
        const float weight = plan.window[k];
        for (std::size_t i = 0; i < stride; ++i) {
            const float wx = weight * x[i], wy = weight * y[i];
            mean_x[i] += wx;
            mean_y[i] += wy;
            square_x[i] += wx * x[i];
            square_y[i] += wy * y[i];
            product[i] += wx * y[i];
        }
    }
}

// Along a row: count values, each from kWindow that lie step apart.
FOURD_INLINE void along(const Window& window, const float* from, std::size_t count, std::size_t step, float* to) {
    for (std::size_t i = 0; i < count; ++i) to[i] = window[0] * from[i];
    for (int k = 1; k < kWindow; ++k) {
        const float weight = window[k];
        const float* shifted = from + k * step;
        for (std::size_t i = 0; i < count; ++i) to[i] += weight * shifted[i];
    }
}

// The sum of a row's similarities from its means (rows of stride); slopes has kSlopes rows of valid, or is null.
FOURD_INLINE double compare(const Plan& plan, const float* means, float* slopes) {
    const std::size_t stride = plan.stride, valid = plan.valid;
    const float *mean_x = means, *mean_y = means + stride, *square_x = means + 2 * stride;
    const float *square_y = means + 3 * stride, *product = means + 4 * stride;
    double sums[kLanes] = {};
    for (std::size_t i = 0; i < valid; ++i) {
        const float x = mean_x[i], y = mean_y[i];
        const float luminance_up = 2 * x * y + kLuminance, luminance_down = x * x + y * y + kLuminance;
        const float contrast_up = 2 * (product[i] - x * y) + kContrast;
        const float contrast_down = (square_x[i] - x * x) + (square_y[i] - y * y) + kContrast;
        const float share = 1.0f / (luminance_down * contrast_down);
        const float value = luminance_up * contrast_up * share;
        sums[i % kLanes] += value;
        if (!slopes) continue;
        slopes[i] = 2 * y * (contrast_up - luminance_up) * share +
                    2 * x * value * (1.0f / contrast_down - 1.0f / luminance_down);
        slopes[valid + i] = -value / contrast_down;
        slopes[2 * valid + i] = 2 * luminance_up * share;
    }
    double total = 0;
    for (const double sum : sums) total += sum;
    return total;
}

// Valid row: its sum of similarities, and where wanted its slopes. scratch has 2 * kMeans rows of stride.
FOURD_INLINE double compare_row(const Plan& plan, std::size_t row, float* scratch, float* slopes) {
    float* means = scratch + kMeans * plan.stride;
    down(plan, row, scratch);
    for (int mean = 0; mean < kMeans; ++mean) {
        along(plan.window, scratch + mean * plan.stride, plan.valid, plan.pictures.channels, means + mean * plan.stride);
    }
    return compare(plan, means, slopes);
}

// Row of the picture: its gradient, from the slopes of all windows that hold it. scratch has 2 rows of
// stride + kReach * channels.
FOURD_INLINE void gradient_row(const Plan& plan, int row, const float* slopes, float* scratch, float* out) {
    const std::size_t stride = plan.stride, valid = plan.valid;
    const std::size_t border = static_cast<std::size_t>(kReach) * plan.pictures.channels;
    const float* x = plan.pictures.picture + row * stride;
    const float* y = plan.pictures.truth + row * stride;
    float *padded = scratch, *spread = scratch + stride + border;
    for (int slope = 0; slope < kSlopes; ++slope) {
        // Nothing beyond the valid part: a window's weights end there. They are symmetric.
        std::fill_n(padded, stride + border, 0.0f);
        for (int k = std::max(0, row - plan.valid_rows + 1); k < kWindow && k <= row; ++k) {
            const float* from = slopes + (static_cast<std::size_t>(row - k) * kSlopes + slope) * valid;
            const float weight = plan.window[k];
            for (std::size_t i = 0; i < valid; ++i) padded[border + i] += weight * from[i];
        }
        along(plan.window, padded, stride, plan.pictures.channels, spread);
        if (slope == 0) {
            for (std::size_t i = 0; i < stride; ++i) out[i] = plan.scale * spread[i];
        } else {
            const float factor = slope == 1 ? 2 * plan.scale : plan.scale;
            const float* by = slope == 1 ? x : y;
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
