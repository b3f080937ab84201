#include <algorithm>
#include <vector>

#include "common/team.h"
#include "sources/cpu/loops.h"

namespace fourd::sources {
namespace {

constexpr std::size_t kPointsPerTask = 32 * kRun;

// Splits the points in [begin, end) into batches and calls work(first, count) for each batch.
template <typename Work>
void for_runs(std::size_t begin, std::size_t end, const Work& work) {
    for (std::size_t first = begin; first < end; first += kRun) {
        work(first, static_cast<int>(std::min<std::size_t>(kRun, end - first)));
    }
}

}  // namespace

void sample(const Query& query, const Samples& out) {
    const RunLoops& loops = select_loops(query.simd).of(query.maps.channels);
    const std::size_t parts = (query.count + kPointsPerTask - 1) / kPointsPerTask;
    const int tasks = static_cast<int>(parts * query.views);
    Team team(std::min(query.threads, tasks));
    team.run(tasks, [&](int task, int) {
        const std::size_t view = static_cast<std::size_t>(task) / parts, begin = task % parts * kPointsPerTask;
        for_runs(begin, std::min(query.count, begin + kPointsPerTask),
                 [&](std::size_t first, int count) { loops.sample(query, view, first, count, out); });
    });
}

// Each view has one task, so that the gradient of the view's features is summed in a fixed order. After all tasks, the
// gradient of xyz is summed over the views.
void sample_backward(const Query& query, const float* gradient, const Gradients& out) {
    const RunLoops& loops = select_loops(query.simd).of(query.maps.channels);
    const std::size_t views = static_cast<std::size_t>(query.views), numbers = 3 * query.count;
    std::vector<float> by_view(views * numbers);
    Team team(std::min(query.threads, query.views));
    team.run(query.views, [&](int view, int) {
        const std::size_t size = feature_size(query.maps);
        float* const to = out.features ? out.features + view * size : nullptr;
        if (to) std::fill_n(to, size, 0.0f);
        for_runs(0, query.count, [&](std::size_t first, int count) {
            loops.backward(query, gradient, view, first, count, to, by_view.data() + view * numbers);
        });
    });
    std::copy_n(by_view.begin(), numbers, out.xyz);
    for (std::size_t view = 1; view < views; ++view) {
        for (std::size_t i = 0; i < numbers; ++i) out.xyz[i] += by_view[view * numbers + i];
    }
}

}  // namespace fourd::sources
