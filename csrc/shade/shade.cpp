#include "shade/shade.h"

#include "common/team.h"
#include "shade/block.h"

namespace fourd::shade {
namespace {

constexpr std::size_t kTaskPoints = 64 * kBlock;

void shade_range_baseline(const Points& points, std::size_t begin, std::size_t end, const Settings& settings,
                          float* out) {
    for (std::size_t first = begin; first < end; first += kBlock)
        shade_block(points, first, static_cast<int>(std::min<std::size_t>(kBlock, end - first)), settings, out);
}

#if defined(__GNUC__) && defined(FOURD_X86)
#define FOURD_SHADE_AVX2
__attribute__((target("avx2"))) void shade_range_avx2(const Points& points, std::size_t begin, std::size_t end,
                                                      const Settings& settings, float* out) {
    for (std::size_t first = begin; first < end; first += kBlock)
        shade_block(points, first, static_cast<int>(std::min<std::size_t>(kBlock, end - first)), settings, out);
}
#endif

using Range = void (*)(const Points&, std::size_t, std::size_t, const Settings&, float*);

Range range_for(Simd simd) {
#ifdef FOURD_SHADE_AVX2
    if (simd != Simd::baseline) return shade_range_avx2;
#endif
    (void)simd;
    return shade_range_baseline;
}

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
    range_for(settings.simd)(points, begin, end, settings, out);
}

}  // namespace fourd::shade
