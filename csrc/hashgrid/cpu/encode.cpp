#include <algorithm>
#include <cstring>

#include "common/pages.h"
#include "common/team.h"
#include "hashgrid/cpu/loops.h"

namespace fourd::hashgrid {
namespace {

// Number of points per task. It is small enough that the encodings of the points stay in the L2 cache while the worker
// processes one level after another, and large enough that the points share many table entries.
constexpr std::size_t kPointsPerTask = 4096;

// Sets the entries of a level, and the padding after them, to zero.
void clear(const Query& query, int l, float* grad_table) {
    const std::size_t begin = query.levels[l].first;
    const std::size_t end = l + 1 < query.level_count ? query.levels[l + 1].first : query.entries;
    std::memset(grad_table + begin * query.features, 0, (end - begin) * query.features * sizeof(float));
}

}  // namespace

void encode(const Query& query, float* out) {
    const LevelLoops& loops = select_loops(query.simd).of(query.features);
    Team team(query.threads);
    run_parts(team, query.count, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        for (int l = 0; l < query.level_count; ++l) loops.encode(query, l, begin, end, out);
    });
}

void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates) {
    const LevelLoops& loops = select_loops(query.simd).of(query.features);
    Team team(query.threads);
    if (grad_table != nullptr) {
        prefer_huge_pages(grad_table, query.entries * query.features * sizeof(float));
        // Each level is one task, in which a single worker processes all points in order. Therefore, no locks are
        // needed, and the order of additions is fixed.
        team.run(query.level_count, [&](int task, int) {
            // The last tasks process small levels, so that the workers finish at about the same time.
            const int l = query.level_count - 1 - task;
            clear(query, l, grad_table);
            loops.scatter(query, l, gradient, grad_table);
        });
    }
    if (grad_coordinates == nullptr) return;
    run_parts(team, query.count, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        std::memset(grad_coordinates + 3 * begin, 0, 3 * (end - begin) * sizeof(float));
        for (int l = 0; l < query.level_count; ++l)
            loops.coordinate_gradient(query, l, begin, end, gradient, grad_coordinates);
    });
}

}  // namespace fourd::hashgrid
