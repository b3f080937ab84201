#include "common/pages.h"
#include "common/team.h"
#include "texture/cpu/tasks.h"

namespace fourd::texture {

void sample(const Query& query, float* out) {
    const Loops& loops = select_loops(query.simd);
    const std::vector<Task> tasks = tasks_of(query);
    prefer_huge_pages(out, query.pictures * query.pixels * query.texture.shape.channels * sizeof(float));
    Team team(query.threads);
    team.run(static_cast<int>(tasks.size()), [&](int task, int) { loops.sample(query, tasks[task], out); });
}

void build_mips(const Shape& shape, const float* base, float* const* mips, int threads, Simd simd) {
    const Loops& loops = select_loops(simd);
    Team team(threads);
    for (int level = 1; level < shape.level_count; ++level) {
        const float* const fine = level == 1 ? base : mips[level - 2];
        float* const out = mips[level - 1];
        prefer_huge_pages(out, shape.items * shape.floats(level) * sizeof(float));
        for_halved_rows(shape, level, team, [&](const HalvedRows& rows) {
            loops.halve(fine + rows.fine, rows.fine_width, rows.halves_rows, shape.channels, rows.count,
                        out + rows.coarse);
        });
    }
}

}  // namespace fourd::texture
