#include <algorithm>
#include <cstring>

#include "common/pages.h"
#include "common/team.h"
#include "hashgrid/cpu/runs.h"

namespace fourd::hashgrid {
namespace {

// Few enough that their rows stay in the second-level cache from level to level, many enough that a level does too.
constexpr std::size_t kPointsPerTask = 4096;

// A copy of each loop for each instruction set and number of features.
struct Loops {
    void (*encode)(const Query&, int, std::size_t, std::size_t, float*);
    void (*scatter)(const Query&, int, const float*, float*);
    void (*move)(const Query&, int, std::size_t, std::size_t, const float*, float*);
};

#define FOURD_LOOPS(NAME, TARGET)                                                                                   \
    TARGET void find_##NAME(const Level& level, const float* coordinates, int count, Cells* out) {                  \
        find_cells(level, coordinates, count, out);                                                                 \
    }                                                                                                               \
    template <int Features>                                                                                         \
    TARGET void encode_##NAME(const Query& query, int level, std::size_t begin, std::size_t end, float* out) {      \
        encode_level<find_##NAME, Features>(query, level, begin, end, out);                                         \
    }                                                                                                               \
    template <int Features>                                                                                         \
    TARGET void scatter_##NAME(const Query& query, int level, const float* gradient, float* out) {                  \
        scatter_level<find_##NAME, Features>(query, level, gradient, out);                                          \
    }                                                                                                               \
    template <int Features>                                                                                         \
    TARGET void move_##NAME(const Query& query, int level, std::size_t begin, std::size_t end,                      \
                            const float* gradient, float* out) {                                                    \
        move_level<find_##NAME, Features>(query, level, begin, end, gradient, out);                                 \
    }                                                                                                               \
    template <int Features>                                                                                         \
    constexpr Loops one_##NAME = {encode_##NAME<Features>, scatter_##NAME<Features>, move_##NAME<Features>};        \
    constexpr Loops loops_##NAME[kMostFeatures] = {one_##NAME<1>, one_##NAME<2>, one_##NAME<3>, one_##NAME<4>,      \
                                                   one_##NAME<5>, one_##NAME<6>, one_##NAME<7>, one_##NAME<8>};

FOURD_LOOPS(baseline, )
#if defined(FOURD_X86) && defined(__GNUC__)
FOURD_LOOPS(avx2, __attribute__((target("avx2,fma,prfchw"))))
#endif

Loops loops_for(const Query& query) {
#if defined(FOURD_X86) && defined(__GNUC__)
    // Memory sets the pace: with loops of its own AVX-512 would take a twentieth less, which is not worth their size.
    if (query.simd != Simd::baseline) return loops_avx2[query.features - 1];
#endif
    return loops_baseline[query.features - 1];
}

// Calls work(begin, end) for stretches of the points, on every worker of the team.
template <typename Work>
void for_stretches(const Query& query, Team& team, const Work& work) {
    team.run(static_cast<int>((query.count + kPointsPerTask - 1) / kPointsPerTask), [&](int task, int) {
        const std::size_t begin = task * kPointsPerTask;
        work(begin, std::min(query.count, begin + kPointsPerTask));
    });
}

// Zeros in a level's entries, and in those between it and the next.
void clear(const Query& query, int l, float* grad_table) {
    const std::size_t begin = query.levels[l].first;
    const std::size_t end = l + 1 < query.level_count ? query.levels[l + 1].first : query.entries;
    std::memset(grad_table + begin * query.features, 0, (end - begin) * query.features * sizeof(float));
}

}  // namespace

void encode(const Query& query, float* out) {
    const Loops loops = loops_for(query);
    Team team(query.threads);
    for_stretches(query, team, [&](std::size_t begin, std::size_t end) {
        for (int l = 0; l < query.level_count; ++l) loops.encode(query, l, begin, end, out);
    });
}

void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates) {
    const Loops loops = loops_for(query);
    Team team(query.threads);
    if (grad_table != nullptr) {
        prefer_huge_pages(grad_table, query.entries * query.features * sizeof(float));
        // One worker does a level from its first point to its last: nothing to lock, and sums taken in one order.
        team.run(query.level_count, [&](int task, int) {
            const int l = query.level_count - 1 - task;  // the small levels last, to fill what time is left
            clear(query, l, grad_table);
            loops.scatter(query, l, gradient, grad_table);
        });
    }
    if (grad_coordinates == nullptr) return;
    for_stretches(query, team, [&](std::size_t begin, std::size_t end) {
        std::memset(grad_coordinates + 3 * begin, 0, 3 * (end - begin) * sizeof(float));
        for (int l = 0; l < query.level_count; ++l) loops.move(query, l, begin, end, gradient, grad_coordinates);
    });
}

}  // namespace fourd::hashgrid
