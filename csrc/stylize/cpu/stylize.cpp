#include "stylize/stylize.h"

#include <algorithm>
#include <atomic>
#include <vector>

#include "common/team.h"
#include "stylize/cpu/loops.h"

namespace fourd::stylize {
namespace {

// A task divides its rows into columns that are kRun pixels wide, and shades one column after another. With 8 rows, the
// pixels that one column reads fit into the L1 cache, so pixels that the next column reads again are still there.
constexpr int kRowsPerTask = 8;

// Decides when the lines in the rows of a task can be drawn. A line is a stroke where the depth or the normal of the
// surface changes abruptly. The lines can be drawn as soon as shading is finished in all tasks that have a row at most
// `reach` rows away from these rows. Lines are drawn soon after shading, while the rows are still in the L2 cache.
class Progress {
  public:
    Progress(int tasks, int reach) : tasks_(tasks), neighbours_((reach + kRowsPerTask - 1) / kRowsPerTask), missing_(tasks) {
        for (int task = 0; task < tasks; ++task) missing_[task] = end(task) - begin(task);
    }

    // Records that the task with the index `done` is finished. Calls draw(task) for each task whose lines can now be
    // drawn.
    template <typename Draw>
    void finish(int done, const Draw& draw) {
        for (int task = begin(done); task < end(done); ++task) {
            if (missing_[task].fetch_sub(1, std::memory_order_acq_rel) == 1) draw(task);
        }
    }

  private:
    int begin(int task) const { return std::max(task - neighbours_, 0); }
    int end(int task) const { return std::min(task + neighbours_ + 1, tasks_); }

    int tasks_, neighbours_;
    // For each task, the number of unfinished tasks among the task itself and its neighbours.
    std::vector<std::atomic<int>> missing_;
};

}  // namespace

void stylize(const Surface& surface, const Style& style, int threads, Simd simd, std::uint32_t* line_state,
             std::uint8_t* out) {
    const Loops& loops = select_loops(simd);
    const std::size_t width = static_cast<std::size_t>(surface.width), height = static_cast<std::size_t>(surface.height);
    std::vector<std::uint32_t> own_state(line_state == nullptr ? width * height : 0);
    LineImage lines{line_state == nullptr ? own_state.data() : line_state, nullptr, nullptr, surface.width, surface.height,
                    line_state != nullptr};
    const std::size_t words = height * static_cast<std::size_t>(lines.words());
    std::vector<std::uint64_t> bits(2 * words);
    lines.drawn = bits.data();
    lines.strong = bits.data() + words;
    const int tasks = (surface.height + kRowsPerTask - 1) / kRowsPerTask;
    const auto end_of = [&](int task) { return std::min((task + 1) * kRowsPerTask, surface.height); };
    Progress progress(tasks, speck_reach(style.thickness));
    Team team(threads);
    team.run(tasks, [&](int task, int) {
        loops.shade(surface, style, task * kRowsPerTask, end_of(task), lines, out);
        if (style.lines == Lines::none) return;
        progress.finish(task, [&](int ready) { loops.draw_lines(lines, style, ready * kRowsPerTask, end_of(ready), out); });
    });
}

}  // namespace fourd::stylize
