#include <algorithm>
#include <cstring>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "planes/cpu/runs.h"

namespace fourd::planes {
namespace {

constexpr std::size_t kPointsPerTask = 1024;
constexpr int kCellBits = 5;  // a cell of this order spans 16 x 16 samples of a plane with 512

// A copy of each loop for each instruction set, for 8 features, which is usual, and for any number.
struct Loops {
    void (*sample)(const Query&, const Run&, float*);
    void (*coordinate_gradient)(const Query&, const Run&, const float*, float*);
    void (*scatter)(const Query&, const Run&, int, const float*, float*);
};

#define FOURD_LOOPS(NAME, TARGET, FEATURES)                                                              \
    TARGET void sample_##NAME(const Query& query, const Run& run, float* out) {                          \
        sample_run<FEATURES>(query, run, out);                                                           \
    }                                                                                                    \
    TARGET void coordinate_gradient_##NAME(const Query& query, const Run& run, const float* g, float* out) { \
        coordinate_gradient_run<FEATURES>(query, run, g, out);                                           \
    }                                                                                                    \
    TARGET void scatter_##NAME(const Query& query, const Run& run, int k, const float* g, float* out) {  \
        scatter_plane<FEATURES>(query, run, k, g, out);                                                  \
    }                                                                                                    \
    constexpr Loops loops_##NAME = {sample_##NAME, coordinate_gradient_##NAME, scatter_##NAME};

FOURD_LOOPS(baseline_8, , 8)
FOURD_LOOPS(baseline_any, , 0)
#if defined(FOURD_X86) && defined(__GNUC__)
FOURD_LOOPS(avx2_8, __attribute__((target("avx2,fma"))), 8)
FOURD_LOOPS(avx2_any, __attribute__((target("avx2,fma"))), 0)
#endif

Loops loops_for(const Query& query) {
    const bool usual = query.features == 8;
#if defined(FOURD_X86) && defined(__GNUC__)
    // 8 features fill the vectors of AVX2, so that AVX-512 has no loops of its own.
    if (query.simd != Simd::baseline) return usual ? loops_avx2_8 : loops_avx2_any;
#endif
    return usual ? loops_baseline_8 : loops_baseline_any;
}

// The coordinate's cell on a grid of 2^kCellBits over [-1, 1].
std::uint32_t cell_of(float coordinate) {
    return static_cast<std::uint32_t>(between(coordinate, (1 << kCellBits) + 1).low);
}

// The points sorted by their cell in space, then by index.
Buffer<std::uint32_t> order_by_cell(const Query& query) {
    constexpr std::size_t kCells = std::size_t{1} << (3 * kCellBits);
    Buffer<std::uint32_t> cells(query.count), order(query.count);
    std::vector<std::uint32_t> place(kCells + 1, 0);
    for (std::size_t i = 0; i < query.count; ++i) {
        const float* at = query.coordinates + 4 * i;
        cells[i] = (cell_of(at[2]) << (2 * kCellBits)) | (cell_of(at[1]) << kCellBits) | cell_of(at[0]);
        ++place[cells[i] + 1];
    }
    for (std::size_t cell = 0; cell < kCells; ++cell) place[cell + 1] += place[cell];
    for (std::size_t i = 0; i < query.count; ++i) order[place[cells[i]]++] = static_cast<std::uint32_t>(i);
    return order;
}

// Calls work(run) for parts of all points, on every worker of the team.
template <typename Work>
void for_runs(const Query& query, const Buffer<std::uint32_t>& order, Team& team, const Work& work) {
    const int tasks = static_cast<int>((query.count + kPointsPerTask - 1) / kPointsPerTask);
    team.run(tasks, [&](int task, int) {
        const std::size_t begin = static_cast<std::size_t>(task) * kPointsPerTask;
        work(Run{order.data(), begin, std::min(query.count, begin + kPointsPerTask)});
    });
}

std::size_t size_of(const Query& query, int k) {
    return static_cast<std::size_t>(query.planes[k].rows) * query.planes[k].columns * query.features;
}

// The planes from large to small: a large one last would keep one worker busy while others wait.
std::vector<int> largest_first(const Query& query) {
    std::vector<int> order(static_cast<std::size_t>(query.plane_count));
    for (int k = 0; k < query.plane_count; ++k) order[k] = k;
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return size_of(query, a) > size_of(query, b); });
    return order;
}

}  // namespace

void sample(const Query& query, float* out) {
    const Loops loops = loops_for(query);
    const Buffer<std::uint32_t> order = order_by_cell(query);
    Team team(query.threads);
    for_runs(query, order, team, [&](const Run& run) { loops.sample(query, run, out); });
}

void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates) {
    const Loops loops = loops_for(query);
    const Buffer<std::uint32_t> order = order_by_cell(query);
    Team team(query.threads);
    const std::vector<int> planes = largest_first(query);
    team.run(query.plane_count, [&](int task, int) {
        const int k = planes[task];
        std::memset(grad_planes[k], 0, size_of(query, k) * sizeof(float));
        loops.scatter(query, Run{order.data(), 0, query.count}, k, gradient, grad_planes[k]);
    });
    if (grad_coordinates == nullptr) return;
    for_runs(query, order, team,
             [&](const Run& run) { loops.coordinate_gradient(query, run, gradient, grad_coordinates); });
}

}  // namespace fourd::planes
