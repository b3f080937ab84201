#include "stylize/stylize.h"

#include <algorithm>

#include "common/team.h"
#include "stylize/cpu/loops.h"

namespace fourd::stylize {
namespace {

// The rows that a task reads fit into the L1 cache, so that the pixels that successive runs both read stay in the
// cache.
constexpr std::size_t kRowsPerTask = 8;

}  // namespace

void stylize(const Surface& surface, const Style& style, int threads, Simd simd, std::uint32_t* line_state,
             std::uint8_t* out) {
    const Loops& loops = select_loops(simd);
    Team team(threads);
    run_parts(team, static_cast<std::size_t>(surface.height), kRowsPerTask, [&](std::size_t begin, std::size_t end) {
        loops.rows(surface, style, static_cast<int>(begin), static_cast<int>(end), line_state, out);
    });
}

}  // namespace fourd::stylize
