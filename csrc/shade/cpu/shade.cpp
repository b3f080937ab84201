#include "shade/shade.h"

#include <algorithm>

#include "common/team.h"
#include "shade/cpu/block.h"

namespace fourd::shade {
namespace {

constexpr std::size_t kTaskPoints = 64 * kBlock;

Range range_for(Simd simd) {
#ifdef FOURD_X86
    // Its vectors suit a point's 16 harmonics and 4 views: AVX-512 has no loops of its own.
    if (simd != Simd::baseline) return shade_range_avx2;
#endif
    (void)simd;
    return shade_range_baseline;
}

}  // namespace

void shade_range_baseline(const Points& points, std::size_t begin, std::size_t end, const Settings& settings,
                          float* out) {
    shade_range(points, begin, end, settings, out);
}

void shade(const Points& points, const Settings& settings, float* out) {
    const int tasks = static_cast<int>((points.count + kTaskPoints - 1) / kTaskPoints);
    Team team(std::min(settings.threads, tasks));
    team.run(tasks, [&](int task, int) {
        const std::size_t begin = static_cast<std::size_t>(task) * kTaskPoints;
        shade_some(points, settings, begin, std::min(points.count, begin + kTaskPoints), out);
    });
}

void shade_some(const Points& points, const Settings& settings, std::size_t begin, std::size_t end, float* out) {
    range_for(settings.simd)(points, begin, end, settings, out);
}

}  // namespace fourd::shade
