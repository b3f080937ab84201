// The inner loop over rows of pixels, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "stylize/stylize.h"

namespace fourd::stylize {

constexpr int kRun = 64;  // Number of pixels of a run: adjacent pixels of a row that are computed together.

// The lines of a picture. All arrays belong to the caller. In `drawn` and `strong`, each run of pixels is one word, in
// which bit i belongs to pixel i of the run. Each row of these two arrays starts and ends with one additional word
// without lines.
struct LineImage {
    std::uint32_t* state;   // Shape (height, width), as in stylize().
    std::uint64_t* drawn;   // Shape (height, words()): whether a pixel has a line.
    std::uint64_t* strong;  // Shape (height, words()): whether a pixel has a line with a strength of at least
                            // kLeastStrength.
    int width, height;
    bool has_previous;  // Whether `state` has the lines of the previous image.

    int runs() const { return (width + kRun - 1) / kRun; }
    int words() const { return runs() + 2; }
};

struct Loops {
    // Shades the pixels of the rows [begin, end), and writes their colours to `out`. Also finds the lines of these rows
    // and writes them to `lines`, but does not draw them.
    void (*shade)(const Surface& surface, const Style& style, int begin, int end, const LineImage& lines,
                  std::uint8_t* out);
    // Draws the lines of rows [begin, end) over the picture. Before the call, shade() must have found the lines of
    // these rows and of all rows at most speck_reach() rows away.
    void (*draw_lines)(const LineImage& lines, const Style& style, int begin, int end, std::uint8_t* picture);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::stylize
