#include "shade/cpu/block.h"

namespace fourd::shade {

void shade_range_avx2(const Points& points, std::size_t begin, std::size_t end, const Settings& settings, float* out) {
    shade_range(points, begin, end, settings, out);
}

}  // namespace fourd::shade
