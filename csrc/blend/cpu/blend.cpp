#include "blend/blend.h"

#include <algorithm>
#include <vector>

#include "blend/cpu/loops.h"
#include "common/buffer.h"
#include "common/team.h"

namespace fourd::blend {
namespace {

constexpr std::size_t kPointsPerTask = 64 * kRun;

int task_count(const Inputs& inputs) { return static_cast<int>((inputs.count + kPointsPerTask - 1) / kPointsPerTask); }

// Splits the points of a task into batches, and calls work(first, count) for each batch.
template <typename Work>
void for_runs(const Inputs& inputs, int task, const Work& work) {
    const std::size_t begin = task * kPointsPerTask, end = std::min(inputs.count, begin + kPointsPerTask);
    for (std::size_t first = begin; first < end; first += kRun) {
        work(first, static_cast<int>(std::min<std::size_t>(kRun, end - first)));
    }
}

// Returns the number of floats in the partial sums of one task.
std::size_t sums_size(const Mlp& mlp) {
    return (static_cast<std::size_t>(mlp.channels) * mlp.hidden + mlp.hidden + 1) * kLanes;
}

// Returns sum i, which is stored as kLanes partial sums.
float total(const float* sums, std::size_t i) {
    float out = 0.0f;
    for (int lane = 0; lane < kLanes; ++lane) out += sums[i * kLanes + lane];
    return out;
}

}  // namespace

void logits(const Mlp& mlp, const Inputs& inputs, float* logits) {
    const Loops& loops = select_loops(inputs.simd);
    Team team(inputs.threads);
    team.run(task_count(inputs), [&](int task, int) {
        for_runs(inputs, task, [&](std::size_t first, int count) { loops.forward(mlp, inputs, first, count, logits); });
    });
}

void logits_backward(const Mlp& mlp, const Inputs& inputs, const float* logits, const float* gradient,
                     const Gradients& out) {
    const Loops& loops = select_loops(inputs.simd);
    const std::size_t weights = static_cast<std::size_t>(mlp.channels) * mlp.hidden;
    // Each task has its own sums. The sums of all tasks are added in the order of the tasks, so the result does not
    // depend on the number of threads.
    std::vector<float> sums(task_count(inputs) * sums_size(mlp), 0.0f);
    Team team(inputs.threads);
    team.run(task_count(inputs), [&](int task, int) {
        float* mine = sums.data() + task * sums_size(mlp);
        float* to_out = mine + weights * kLanes;
        for_runs(inputs, task, [&](std::size_t first, int count) {
            loops.backward(mlp, inputs, first, count, logits, gradient, out,
                           {mine, to_out, to_out + mlp.hidden * kLanes});
        });
    });
    std::fill_n(out.weight, weights, 0.0f);
    std::fill_n(out.out, mlp.hidden, 0.0f);
    *out.bias = 0.0f;
    for (int task = 0; task < task_count(inputs); ++task) {
        const float* mine = sums.data() + task * sums_size(mlp);
        for (std::size_t i = 0; i < weights; ++i) out.weight[i] += total(mine, i);
        for (int h = 0; h < mlp.hidden; ++h) out.out[h] += total(mine, weights + h);
        *out.bias += total(mine, weights + mlp.hidden);
    }
}

}  // namespace fourd::blend
