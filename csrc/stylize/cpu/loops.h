// The inner loop over rows of pixels, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "stylize/stylize.h"

namespace fourd::stylize {

constexpr int kRun = 64;  // Number of pixels of a row that are computed together.

// The lines of a picture. All arrays belong to the caller. Each run has a bit for each of its pixels, with bit i for pixel
// i. The words of a row are between two words without lines.
struct LineImage {
    std::uint32_t* state;   // (height, width), as in stylize().
    std::uint64_t* drawn;   // (height, words()): whether a pixel has a line.
    std::uint64_t* strong;  // (height, words()): whether the strength of its line is at least kLeastStrength.
    int width, height;
    bool has_previous;  // Whether `state` has the lines of the previous image.

    int runs() const { return (width + kRun - 1) / kRun; }
    int words() const { return runs() + 2; }
};

struct Loops {
    // Draws rows [begin, end) without lines, and finds their lines.
    void (*shade)(const Surface& surface, const Style& style, int begin, int end, const LineImage& lines,
                  std::uint8_t* out);
    // Draws the lines of rows [begin, end) over the picture. The lines that are at most speck_reach() rows away must be
    // known.
    void (*draw_lines)(const LineImage& lines, const Style& style, int begin, int end, std::uint8_t* picture);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::stylize
