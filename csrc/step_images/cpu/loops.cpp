#include "step_images/cpu/loops.h"

#include "common/inline.h"

namespace fourd::step_images::FOURD_SIMD {
namespace {

constexpr int kLanes = 16;

void convert_row(const std::uint8_t* rgb, const std::uint8_t* matte, int width, float* out, std::size_t plane,
                 float* out_matte) {
    float* FOURD_RESTRICT red = out;
    float* FOURD_RESTRICT green = out + plane;
    float* FOURD_RESTRICT blue = out + 2 * plane;
    for (int x = 0; x < width; ++x) {
        red[x] = static_cast<float>(rgb[3 * x]) / 255.0f;
        green[x] = static_cast<float>(rgb[3 * x + 1]) / 255.0f;
        blue[x] = static_cast<float>(rgb[3 * x + 2]) / 255.0f;
    }
    float* FOURD_RESTRICT seen = out_matte;
    for (int x = 0; x < width; ++x) seen[x] = static_cast<float>(matte[x]) / 255.0f;
}

void premultiply_row(const std::uint8_t* rgb, const std::uint8_t* matte, int width, float* out, float* out_matte) {
    float* FOURD_RESTRICT to = out;
    float* FOURD_RESTRICT seen = out_matte;
    for (int x = 0; x < width; ++x) seen[x] = static_cast<float>(matte[x]) / 255.0f;
    for (int x = 0; x < width; ++x) {
        for (int c = 0; c < 3; ++c) to[3 * x + c] = static_cast<float>(rgb[3 * x + c]) / 255.0f * seen[x];
    }
}

void resolve_row(const Grid& grid, const Samples& samples, const float* background, int y, const Pixels& out) {
    const std::size_t step = static_cast<std::size_t>(grid.width) * grid.samples;
    const float count = static_cast<float>(grid.samples * grid.samples);
    for (int x = 0; x < grid.width; ++x) {
        float sums[5] = {};
        for (int row = 0; row < grid.samples; ++row) {
            const std::size_t first = (static_cast<std::size_t>(y) * grid.samples + row) * step + x * grid.samples;
            for (int column = 0; column < grid.samples; ++column) {
                for (int c = 0; c < 4; ++c) sums[c] += samples.features[4 * (first + column) + c];
                sums[4] += samples.alpha[first + column];
            }
        }
        const std::size_t pixel = static_cast<std::size_t>(y) * grid.width + x;
        const float clear = 1.0f - sums[4] / count;
        out.last[pixel] = sums[3] / count;
        for (int c = 0; c < 3; ++c) {
            const float colour = sums[c] / count;
            out.colour[3 * pixel + c] = colour;
            out.prediction[3 * pixel + c] = colour + clear * background[c];
        }
    }
}

void resolve_row_backward(const Grid& grid, const PixelGradients& gradients, const float* background, int y,
                          float* out_features, float* out_alpha) {
    const std::size_t step = static_cast<std::size_t>(grid.width) * grid.samples;
    const float count = static_cast<float>(grid.samples * grid.samples);
    for (int x = 0; x < grid.width; ++x) {
        const std::size_t pixel = static_cast<std::size_t>(y) * grid.width + x;
        float to[4], to_alpha = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float g = gradients.prediction ? gradients.prediction[3 * pixel + c] : 0.0f;
            to[c] = (gradients.colour ? gradients.colour[3 * pixel + c] + g : g) / count;
            to_alpha -= g * background[c];
        }
        to[3] = gradients.last ? gradients.last[pixel] / count : 0.0f;
        to_alpha /= count;
        for (int row = 0; row < grid.samples; ++row) {
            const std::size_t first = (static_cast<std::size_t>(y) * grid.samples + row) * step + x * grid.samples;
            for (int column = 0; column < grid.samples; ++column) {
                for (int c = 0; c < 4; ++c) out_features[4 * (first + column) + c] = to[c];
                out_alpha[first + column] = to_alpha;
            }
        }
    }
}

void add_background(std::size_t count, const float* rgb, const float* alpha, const float* background, float* out) {
    float* FOURD_RESTRICT to = out;
    for (std::size_t i = 0; i < count; ++i) {
        for (int c = 0; c < 3; ++c) to[3 * i + c] = rgb[3 * i + c] + (1.0f - alpha[i]) * background[c];
    }
}

FOURD_INLINE float clamp01(float value) { return value < 0.0f ? 0.0f : value > 1.0f ? 1.0f : value; }

// Adds the squares of `count` <= kLanes differences to `sums`, one in each lane. The first `skipped` do not count.
FOURD_INLINE void add_squares(int count, int skipped, const float* values, const float* truth, bool clamps,
                              const Factors& factors, float* gradient, float* sums) {
    float difference[kLanes];
    for (int i = 0; i < count; ++i) difference[i] = values[i];
    if (clamps) {
        for (int i = 0; i < count; ++i) difference[i] = clamp01(difference[i]);
    }
    if (truth) {
        for (int i = 0; i < count; ++i) difference[i] -= truth[i];
    }
    for (int i = 0; i < count; ++i) difference[i] = i < skipped ? 0.0f : difference[i];
    for (int i = 0; i < count; ++i) sums[i] += difference[i] * difference[i];
    if (gradient) {
        for (int i = 0; i < count; ++i) gradient[i] = factors.scale * difference[i] * factors.upstream;
    }
}

double sum_squares(const Table& table, const float* values, const float* truth, bool clamps,
                   const Factors& factors, float* gradient) {
    float sums[kLanes] = {};
    for (std::size_t row = 0; row < table.rows; ++row) {
        for (int column = 0; column < table.columns; column += kLanes) {
            const std::size_t at = row * table.columns + column;
            const int skipped = table.first - column, left = table.columns - column;
            const float* other = truth ? truth + at : nullptr;
            float* to = gradient ? gradient + at : nullptr;
            if (left >= kLanes) {
                add_squares(kLanes, skipped, values + at, other, clamps, factors, to, sums);
            } else {
                add_squares(left, skipped, values + at, other, clamps, factors, to, sums);
            }
        }
    }
    double total = 0.0;
    for (const float sum : sums) total += static_cast<double>(sum);
    return total;
}

}  // namespace

const Loops loops = {convert_row,          premultiply_row, resolve_row,
                     resolve_row_backward, add_background,  sum_squares};

}  // namespace fourd::step_images::FOURD_SIMD
