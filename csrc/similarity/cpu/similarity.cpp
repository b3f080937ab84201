#include "similarity/similarity.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "similarity/cpu/loops.h"

namespace fourd::similarity {
namespace {

constexpr double kSigma = 1.5;
constexpr int kRowsPerTask = 16;

Window gaussian() {
    double weights[kWindow], total = 0;
    for (int k = 0; k < kWindow; ++k) {
        const double offset = k - kBorder / 2;
        weights[k] = std::exp(-offset * offset / (2 * kSigma * kSigma));
        total += weights[k];
    }
    Window out{};
    for (int k = 0; k < kWindow; ++k) out.weights[k] = static_cast<float>(weights[k] / total);
    return out;
}

// Calls work(row, worker) for each row, on all workers of the team.
template <typename Work>
void for_rows(Team& team, int rows, const Work& work) {
    team.run((rows + kRowsPerTask - 1) / kRowsPerTask, [&](int task, int worker) {
        for (int row = task * kRowsPerTask; row < std::min(rows, (task + 1) * kRowsPerTask); ++row) work(row, worker);
    });
}

}  // namespace

Plan::Plan(const Pictures& of)
    : pictures(of),
      window(gaussian()),
      stride(static_cast<std::size_t>(of.width) * of.channels),
      valid(static_cast<std::size_t>(of.width - kBorder) * of.channels),
      rows(of.height),
      valid_rows(of.height - kBorder),
      scale(1.0f / (static_cast<float>(valid) * static_cast<float>(valid_rows))) {}

double similarity(const Pictures& pictures, float* gradient) {
    const Plan plan(pictures);
    const Loops& loops = select_loops(pictures.simd);
    Team team(pictures.threads);
    const std::size_t border = static_cast<std::size_t>(kBorder) * pictures.channels;
    std::vector<Buffer<float>> scratch(team.size());
    for (Buffer<float>& one : scratch) one.require(2 * kMeans * plan.stride + 2 * border);
    Buffer<float> derivatives;
    if (gradient) derivatives.require(kDerivatives * plan.valid * plan.valid_rows);
    std::vector<double> sums(plan.valid_rows);
    for_rows(team, plan.valid_rows, [&](int row, int worker) {
        float* const to = gradient ? derivatives.data() + kDerivatives * plan.valid * row : nullptr;
        sums[row] = loops.compare(plan, row, scratch[worker].data(), to);
    });
    if (gradient) {
        for_rows(team, plan.rows, [&](int row, int worker) {
            loops.gradient(plan, row, derivatives.data(), scratch[worker].data(), gradient + row * plan.stride);
        });
    }
    double total = 0;
    // Rows are added in order, so the total is the same for any number of threads.
    for (const double sum : sums) total += sum;
    return total / (static_cast<double>(plan.valid) * plan.valid_rows);
}

}  // namespace fourd::similarity
