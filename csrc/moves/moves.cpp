#include "moves/moves.h"

#include <algorithm>
#include <cmath>

#include "common/team.h"

namespace fourd::moves {
namespace {

constexpr std::size_t kRowsPerTask = 1024;
constexpr std::size_t kNumbersPerTask = 16384;

// Calls work(begin, end) for parts of the rows, on all threads.
template <typename Work>
void for_parts(const Rows& rows, const Work& work) {
    Team team(rows.count > kRowsPerTask ? rows.threads : 1);
    run_parts(team, rows.count, kRowsPerTask, work);
}

// Calls work(i, rows.at[i]) for all rows.
template <typename Work>
void for_rows(const Rows& rows, const Work& work) {
    for_parts(rows, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) work(i, static_cast<std::size_t>(rows.at[i]));
    });
}

// Adam's bias corrections by the number of updates. The rows of a part have few different numbers, and computing the
// powers for each row took most of the time of an update.
class Corrections {
  public:
    struct Entry {
        float step, first, second;
    };

    explicit Corrections(Betas betas) : betas_(betas) {
        std::fill_n(entries_, kEntries, Entry{-1.0f, 0.0f, 0.0f});
    }

    const Entry& at(float step) {
        const bool is_small = step >= 0.0f && step < 1e6f;
        Entry& entry = entries_[is_small ? static_cast<int>(step) % kEntries : 0];
        if (entry.step != step) {
            entry = {step, 1 - std::pow(betas_.first, step), 1 - std::pow(betas_.second, step)};
        }
        return entry;
    }

  private:
    static constexpr int kEntries = 256;

    Betas betas_;
    Entry entries_[kEntries];
};

// Returns the matte at a pixel position, interpolated bilinearly and continued beyond its border.
float matte_at(const Silhouette& view, float u, float v) {
    const float x = std::min(std::max(u - 0.5f, 0.0f), static_cast<float>(view.width - 1));
    const float y = std::min(std::max(v - 0.5f, 0.0f), static_cast<float>(view.height - 1));
    const int left = static_cast<int>(x), top = static_cast<int>(y);
    const int right = std::min(left + 1, view.width - 1), bottom = std::min(top + 1, view.height - 1);
    const float fx = x - static_cast<float>(left), fy = y - static_cast<float>(top);
    const float* upper = view.matte + static_cast<std::size_t>(top) * view.width;
    const float* lower = view.matte + static_cast<std::size_t>(bottom) * view.width;
    return (1 - fy) * ((1 - fx) * upper[left] + fx * upper[right]) +
           fy * ((1 - fx) * lower[left] + fx * lower[right]);
}

struct Place {
    bool is_in_image, is_covered;
};

Place place_of(const Silhouette& view, const float* xyz) {
    const sources::Projection at = sources::project(view.camera, xyz);
    const bool is_in_image = at.z > 0.0f && at.u > 0.0f && at.v > 0.0f && at.u < static_cast<float>(view.width) &&
                             at.v < static_cast<float>(view.height);
    return {is_in_image, is_in_image && matte_at(view, at.u, at.v) >= 0.5f};
}

float finite(float gradient) {
    if (std::isnan(gradient)) return 0.0f;
    return std::min(std::max(gradient, -3.40282347e38f), 3.40282347e38f);
}

}  // namespace

void adam(const std::vector<Dense>& arrays, Betas betas, float epsilon, int threads) {
    struct Part {
        const Dense* of;
        std::size_t begin, end;
    };
    std::vector<Part> parts;
    for (const Dense& each : arrays) {
        for (std::size_t begin = 0; begin < each.size; begin += kNumbersPerTask) {
            parts.push_back({&each, begin, std::min(each.size, begin + kNumbersPerTask)});
        }
    }
    Team team(threads);
    team.run(static_cast<int>(parts.size()), [&](int task, int) {
        const Dense& of = *parts[task].of;
        for (std::size_t i = parts[task].begin; i < parts[task].end; ++i) {
            const float gradient = of.gradient[i];
            of.first[i] += (1 - betas.first) * (gradient - of.first[i]);
            of.second[i] = betas.second * of.second[i] + (1 - betas.second) * gradient * gradient;
            of.parameter[i] -= of.step_size * of.first[i] / (std::sqrt(of.second[i]) / of.root_correction + epsilon);
        }
    });
}

void adam_rows(const Rows& rows, float* steps, const std::vector<Sparse>& parameters, Betas betas) {
    for_parts(rows, [&](std::size_t begin, std::size_t end) {
        Corrections corrections(betas);
        for (std::size_t i = begin; i < end; ++i) {
            const std::size_t row = static_cast<std::size_t>(rows.at[i]);
            const Corrections::Entry& correction = corrections.at(steps[row] += 1.0f);
            for (const Sparse& each : parameters) {
                const float rate = each.rates[each.is_constant ? 0 : i] / correction.first;
                for (int c = 0; c < each.columns; ++c) {
                    const std::size_t at = row * each.columns + c;
                    const float gradient = finite(each.gradient[i * each.columns + c]);
                    each.first[at] += (1 - betas.first) * (gradient - each.first[at]);
                    each.second[at] += (1 - betas.second) * (gradient * gradient - each.second[at]);
                    const float scale = std::sqrt(each.second[at] / correction.second) + each.epsilon;
                    each.parameter[at] -= rate * each.first[at] / scale;
                }
            }
        }
    });
}

void smooth(const Rows& rows, float* xyz, const Smoothing& smoothing) {
    for_rows(rows, [&](std::size_t i, std::size_t row) {
        const float *plane = smoothing.planes + 4 * row, spacing = smoothing.spacing[row];
        float* at = xyz + 3 * row;
        const float height = plane[0] * at[0] + plane[1] * at[1] + plane[2] * at[2] - plane[3];
        const float tolerance = smoothing.tolerance * spacing;
        const float excess = height - std::min(std::max(height, -tolerance), tolerance);
        const float share = std::min(smoothing.strength * smoothing.rates[i] / spacing, smoothing.max_share);
        for (int axis = 0; axis < 3; ++axis) at[axis] -= share * excess * plane[axis];
    });
}

void keep_in_silhouettes(const Rows& rows, float* xyz, const float* before, const std::vector<Silhouette>& views) {
    for_rows(rows, [&](std::size_t i, std::size_t row) {
        for (const Silhouette& view : views) {
            const Place now = place_of(view, xyz + 3 * row);
            if (!now.is_in_image || now.is_covered || !place_of(view, before + 3 * i).is_covered) continue;
            std::copy_n(before + 3 * i, 3, xyz + 3 * row);
            return;
        }
    });
}

void keep_beyond(const Rows& rows, float* xyz, const float* before, const float* axis, const float* centre,
                 float near) {
    for_rows(rows, [&](std::size_t i, std::size_t row) {
        float depth = 0.0f;
        for (int k = 0; k < 3; ++k) depth += (xyz[3 * row + k] - centre[k]) * axis[k];
        if (depth < near) std::copy_n(before + 3 * i, 3, xyz + 3 * row);
    });
}

void add_magnitudes(const Rows& rows, const float* gradient, const float* spacing, float* sum, float* count) {
    for_rows(rows, [&](std::size_t i, std::size_t row) {
        float square = 0.0f;
        for (int k = 0; k < 3; ++k) square += finite(gradient[3 * i + k]) * finite(gradient[3 * i + k]);
        const float magnitude = std::sqrt(square) * spacing[row];
        sum[row] += magnitude;
        count[row] += magnitude > 0.0f ? 1.0f : 0.0f;
    });
}

}  // namespace fourd::moves
