#include "step_images/step_images.h"

#include <algorithm>
#include <vector>

#include "common/team.h"
#include "step_images/cpu/loops.h"

namespace fourd::step_images {
namespace {

constexpr int kRows = 16;
constexpr std::size_t kNumbers = 16384;
constexpr std::size_t kPixelsPerThread = 65536;  // Fewer pixels take less time than the start of a thread.

int threads_for(const Execution& execution, std::size_t pixels) {
    const std::size_t useful = std::max<std::size_t>(1, pixels / kPixelsPerThread);
    return static_cast<int>(std::min<std::size_t>(useful, static_cast<std::size_t>(execution.threads)));
}

// Calls work(first, last) for ranges of rows, on all workers of the team.
template <typename Work>
void for_rows(Team& team, int rows, const Work& work) {
    run_parts(team, static_cast<std::size_t>(std::max(rows, 0)), kRows, [&](std::size_t first, std::size_t last) {
        for (std::size_t y = first; y < last; ++y) work(static_cast<int>(y));
    });
}

std::size_t samples_of(const Grid& grid) {
    return static_cast<std::size_t>(grid.height) * grid.width * grid.samples * grid.samples;
}

}  // namespace

void convert_views(const View* views, int count, int height, int width, const Execution& execution, float* out_images,
                   float* out_mattes) {
    const Loops& loops = select_loops(execution.simd);
    const std::size_t plane = static_cast<std::size_t>(height) * width;
    Team team(threads_for(execution, count * plane));
    for_rows(team, count * height, [&](int row) {
        const View& view = views[row / height];
        const int y = row % height, used = y < view.height ? view.width : 0;
        float* image = out_images + row / height * 3 * plane + static_cast<std::size_t>(y) * width;
        float* matte = out_mattes + static_cast<std::size_t>(row) * width;
        if (used > 0) {
            const std::size_t from = static_cast<std::size_t>(y) * view.width;
            loops.convert_row(view.rgb + 3 * from, view.matte + from, used, image, plane, matte);
        }
        for (int c = 0; c < 3; ++c) std::fill(image + c * plane + used, image + c * plane + width, 0.0f);
        std::fill(matte + used, matte + width, 0.0f);
    });
}

void premultiply(const View& view, const Execution& execution, float* out_rgb, float* out_matte) {
    const Loops& loops = select_loops(execution.simd);
    Team team(threads_for(execution, static_cast<std::size_t>(view.height) * view.width));
    for_rows(team, view.height, [&](int y) {
        const std::size_t at = static_cast<std::size_t>(y) * view.width;
        loops.premultiply_row(view.rgb + 3 * at, view.matte + at, view.width, out_rgb + 3 * at, out_matte + at);
    });
}

void resolve(const Grid& grid, const Samples& samples, const float background[3], const Execution& execution,
             const Pixels& out) {
    const Loops& loops = select_loops(execution.simd);
    Team team(threads_for(execution, samples_of(grid)));
    for_rows(team, grid.height, [&](int y) { loops.resolve_row(grid, samples, background, y, out); });
}

void resolve_backward(const Grid& grid, const PixelGradients& gradients, const float background[3],
                      const Execution& execution, float* out_features, float* out_alpha) {
    const Loops& loops = select_loops(execution.simd);
    Team team(threads_for(execution, samples_of(grid)));
    for_rows(team, grid.height, [&](int y) {
        loops.resolve_row_backward(grid, gradients, background, y, out_features, out_alpha);
    });
}

void add_background(std::size_t count, const float* rgb, const float* alpha, const float background[3],
                    const Execution& execution, float* out) {
    const Loops& loops = select_loops(execution.simd);
    Team team(threads_for(execution, count));
    run_parts(team, count, kNumbers, [&](std::size_t first, std::size_t last) {
        loops.add_background(last - first, rgb + 3 * first, alpha + first, background, out + 3 * first);
    });
}

double mean_square(const Table& table, const float* values, const float* truth, bool clamps, const Execution& execution,
                   float upstream, float* gradient) {
    const Loops& loops = select_loops(execution.simd);
    const std::size_t numbers = table.rows * static_cast<std::size_t>(table.columns - table.first);
    const float scale = numbers > 0 ? 2.0f / static_cast<float>(numbers) : 0.0f;
    // A table whose columns all count is one row of numbers.
    const std::size_t columns = table.first == 0 ? 1 : static_cast<std::size_t>(table.columns);
    const std::size_t rows = table.first == 0 ? numbers : table.rows;
    const std::size_t per_part = std::max<std::size_t>(1, kNumbers / columns);
    std::vector<double> sums((rows + per_part - 1) / per_part);
    Team team(threads_for(execution, numbers));
    run_parts(team, rows, per_part, [&](std::size_t begin, std::size_t end) {
        const std::size_t at = begin * columns;
        const Table part = table.first == 0 ? Table{1, static_cast<int>(end - begin), 0}
                                            : Table{end - begin, table.columns, table.first};
        sums[begin / per_part] = loops.sum_squares(part, values + at, truth ? truth + at : nullptr, clamps, {scale, upstream},
                                                   gradient ? gradient + at : nullptr);
    });
    double total = 0.0;
    for (const double sum : sums) total += sum;
    return numbers > 0 ? total / static_cast<double>(numbers) : 0.0;
}

}  // namespace fourd::step_images
