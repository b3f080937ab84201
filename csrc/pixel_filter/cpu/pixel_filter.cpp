#include "pixel_filter/pixel_filter.h"

#include <cstddef>

#include "common/team.h"
#include "pixel_filter/cpu/loops.h"

namespace fourd::pixel_filter {
namespace {

constexpr std::size_t kRowsPerTask = 32;

}  // namespace

void filter_pixels(const Image& image, float side, int threads, Simd simd, std::uint8_t* out) {
    const Loops& loops = select_loops(simd);
    Team team(threads);
    run_parts(team, static_cast<std::size_t>(image.height), kRowsPerTask, [&](std::size_t begin, std::size_t end) {
        loops.rows(image, side, static_cast<int>(begin), static_cast<int>(end), out);
    });
}

}  // namespace fourd::pixel_filter
