#include "pixel_filter/pixel_filter.h"

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "pixel_filter/cpu/loops.h"

namespace fourd::pixel_filter {
namespace {

constexpr std::size_t kRowsPerTask = 32;

// The buffers for a task's copies of unfiltered rows. A task filters a band of rows in place. It reads a row from a
// copy if the row may already be overwritten in the image.
struct Copies {
    std::uint8_t *above, *below;  // The rows next to the band, which other tasks overwrite.
    std::uint8_t* recent[2];      // The row that is filtered, and the row before it.
};

constexpr std::size_t kCopies = 4;

// An image. copy() copies the columns [left, right) of one of its rows.
struct Canvas {
    std::uint8_t* rgba;
    std::size_t stride, left, right;

    std::uint8_t* row(int index) const { return rgba + stride * static_cast<std::size_t>(index); }
    void copy(int index, std::uint8_t* out) const {
        std::memcpy(out + kChannels * left, row(index) + kChannels * left, kChannels * (right - left));
    }
};

}  // namespace

void filter_pixels(const Image& image, float side, int threads, Simd simd, std::uint8_t* out) {
    const Loops& loops = select_loops(simd);
    Team team(threads);
    const std::size_t stride = kChannels * static_cast<std::size_t>(image.width);
    const auto row_at = [&](int row) { return image.rgba + stride * static_cast<std::size_t>(row); };
    run_parts(team, static_cast<std::size_t>(image.height), kRowsPerTask, [&](std::size_t begin, std::size_t end) {
        for (int row = static_cast<int>(begin); row < static_cast<int>(end); ++row) {
            const Rows rows{row_at(std::max(row - 1, 0)), row_at(row), row_at(std::min(row + 1, image.height - 1))};
            loops.row(rows, image.width, 0, image.width, side, out + stride * static_cast<std::size_t>(row));
        }
    });
}

void filter_in_place(std::uint8_t* rgba, int width, int height, const Region& region, float side, Simd simd, Team& team,
                     Buffer<std::uint8_t>& scratch) {
    if (region.left >= region.right || region.top >= region.bottom) return;
    const Loops& loops = select_loops(simd);
    const Canvas canvas{rgba, kChannels * static_cast<std::size_t>(width),
                        static_cast<std::size_t>(std::max(region.left - 1, 0)),
                        static_cast<std::size_t>(std::min(region.right + 1, width))};
    const std::size_t rows = static_cast<std::size_t>(region.bottom - region.top);
    scratch.require((rows + kRowsPerTask - 1) / kRowsPerTask * kCopies * canvas.stride);
    const auto copies_of = [&](std::size_t begin) {
        std::uint8_t* const first = scratch.data() + begin / kRowsPerTask * kCopies * canvas.stride;
        return Copies{first, first + canvas.stride, {first + 2 * canvas.stride, first + 3 * canvas.stride}};
    };
    run_parts(team, rows, kRowsPerTask, [&](std::size_t begin, std::size_t end) {
        const int first = region.top + static_cast<int>(begin), next = region.top + static_cast<int>(end);
        if (first > 0) canvas.copy(first - 1, copies_of(begin).above);
        if (next < height) canvas.copy(next, copies_of(begin).below);
    });
    run_parts(team, rows, kRowsPerTask, [&](std::size_t begin, std::size_t end) {
        const int first = region.top + static_cast<int>(begin), next = region.top + static_cast<int>(end);
        const Copies copies = copies_of(begin);
        for (int row = first; row < next; ++row) {
            std::uint8_t* const centre = copies.recent[row % 2];
            canvas.copy(row, centre);
            const std::uint8_t* const above = row == 0       ? centre
                                              : row == first ? copies.above
                                                             : copies.recent[(row + 1) % 2];
            const std::uint8_t* const below = row + 1 == height ? centre
                                              : row + 1 == next ? copies.below
                                                                : canvas.row(row + 1);
            loops.row({above, centre, below}, width, region.left, region.right, side, canvas.row(row));
        }
    });
}

}  // namespace fourd::pixel_filter
