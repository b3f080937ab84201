// Decoding of packed scenes. fourd/scene/packed/members.py describes the packed data, and fourd/rendering/ops/unpack/op.py
// documents the operations. Callers check sizes.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/dispatch.h"

namespace fourd::unpack {

constexpr int kShNumbers = 48;
constexpr int kWeightCodes = 256;

// Spherical harmonics. The coefficients of a point are the mean plus a weighted sum of the basis rows. The weights,
// called factors, are stored for each point.
struct Harmonics {
    const std::uint8_t* low;   // Shape (rows, points): low bytes of the zigzag-coded factors.
    const std::uint8_t* high;  // Shape (rows, points): high bytes.
    std::size_t rows, points;
    const float* basis;  // Shape (rows, kShNumbers), already multiplied by the quantization step.
    const float* mean;   // Shape (kShNumbers).
};

// One source view. Each point has a weight code, which is the index of its blend weight in Views::weights. The member
// `colours` is the number of points that also have colour levels. A colour level is the difference between the point's
// colour in this view and its mean colour, in quantization steps. `levels` has three planes, each with `colours` bytes:
// the levels of green, red - green and blue - green.
struct View {
    const std::uint8_t* codes;
    const std::uint8_t* levels;
    std::size_t colours;
};

struct Views {
    const View* views;
    std::size_t view_count, points;
    const std::uint8_t* mean;      // Shape (points, 3): mean colour of each point over the source views.
    const std::uint16_t* weights;  // Shape (kWeightCodes): the blend weight of each code, as a half.
    int colour_step;               // Quantization step of the colour levels, from 1 to 127.
    // If true, every point has colour levels in every view. If false, a point has colour levels only in the views in
    // which its weight code is not 0, and in the other views it gets its mean colour.
    bool every_point_has_colours;
};

// Positions are rounded to a grid of cubic cells. The Morton code of a point interleaves the bits of its three cell
// indices, and the position is lower + step * (cell indices). The differences of successive Morton codes are stored:
// plane k has byte k of every difference, and byte 0 is the lowest byte.
struct Positions {
    const std::uint8_t* planes;  // Shape (code_bytes, points).
    int code_bytes;              // Number of bytes per difference, from 1 to 8.
    std::size_t points;
    const double* lower;  // Shape (3): position of a point with the cell indices 0, 0, 0.
    double step;          // Side length of a cell.
};

// Writes positions (points, 3).
void positions(const Positions& from, float* out);

struct Loops {
    // Writes the coefficients (points, kShNumbers) as halves.
    void (*harmonics)(const Harmonics& from, std::uint16_t* out);
    // Writes the blend weights (points, views) as halves, and the colours (points, views, 3) as bytes. `next` is
    // scratch memory for one index per view.
    void (*views)(const Views& from, std::size_t* next, std::uint16_t* out_weights, std::uint8_t* out_rgb);
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::unpack
