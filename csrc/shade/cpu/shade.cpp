#include "shade/shade.h"

#include <algorithm>

#include "common/team.h"
#include "shade/cpu/loops.h"

namespace fourd::shade {
namespace {

constexpr std::size_t kTaskPoints = 64 * kBlock;

}  // namespace

void shade(const Points& points, const Settings& settings, float* out) {
    const int tasks = static_cast<int>((points.count + kTaskPoints - 1) / kTaskPoints);
    Team team(std::min(settings.threads, tasks));
    team.run(tasks, [&](int task, int) {
        const std::size_t begin = static_cast<std::size_t>(task) * kTaskPoints;
        shade_some(points, settings, begin, std::min(points.count, begin + kTaskPoints), out);
    });
}

void shade_some(const Points& points, const Settings& settings, std::size_t begin, std::size_t end, float* out) {
    select_loops(settings.simd).shade(points, begin, end, settings, out);
}

}  // namespace fourd::shade
