// Loops over the positions of feature maps, compiled once for each instruction set.
#pragma once

#include <cstddef>

#include "common/dispatch.h"
#include "encoder/maps.h"

namespace fourd::encoder {

constexpr int kTile = 8;  // Output channels whose weights are adjacent.

// Weights of a convolution, of which each multiplies the input at a fixed offset: output[i] is the sum over all taps of
// weights[tap] * input[i + offsets[tap]].
struct Taps {
    const std::ptrdiff_t* offsets;  // Shape (count,).
    int count;
    const float* weights;  // Shape (channels / kTile, count, kTile).
};

struct Convolution {
    const float* in;
    Taps taps;
    const float* bias;  // Shape (channels,), or null for zeros.
    float* out;
    std::size_t plane;  // Distance between the planes of `out` and `mask`.
    int channels;       // A multiple of kTile.
    const float* mask;  // Where the mask is not positive, the output is 0. Null for no mask.
    bool rectifies;     // Negative outputs become 0.
    bool stays_inside;  // Nothing is read beyond the positions, because another thread may write there.
};

// The gradient of weights: sums[tap][channel] += sum of gradient[channel][i] * in[i + offsets[tap]].
struct Correlation {
    const float* gradient;
    std::size_t plane;  // Distance between the planes of `gradient`.
    const float* in;
    const std::ptrdiff_t* offsets;
    int taps;
    float* sums;  // Shape (taps, kTile), for kTile channels.
    float* bias;  // Shape (kTile,): sums of the gradient.
};

struct Loops {
    // Computes `count` successive positions.
    void (*convolve)(const Convolution& job, std::size_t count);
    void (*correlate)(const Correlation& job, std::size_t count);

    // Averages squares of `stride` x `stride` pixels of an image (3, height, width), for the rows [from, to) of `out`.
    void (*pool)(const float* image, int height, int width, int stride, const Map& out, int from, int to);

    // Adds the rows [from, to) of a map, upsampled by a factor of two, to `out`.
    void (*add_upsampled)(const Map& coarse, const Map& out, int from, int to, float* scratch);

    // Computes the gradient of add_upsampled with respect to the rows [from, to) of `coarse`.
    void (*upsampled_backward)(const Map& fine, const Map& coarse, int from, int to, float* scratch);

    // Copies the rows [from, to) of the phases of a map.
    void (*split_phases)(const Map& fine, const Map& phases, int from, int to);

    // Adds phases to a map and masks the sum. The phases are planes of `count` positions that begin at row `from` of
    // the coarse level, phase by phase, with kTile channels from `channel` on.
    void (*add_phases)(const float* phases, std::size_t plane, const Level& coarse, const Map& fine, const float* mask,
                       int channel, int from, int to);

    // Converts rows between planes and pixels whose channels are adjacent.
    void (*to_pixels)(const float* planes, std::size_t plane, int channels, int width, float* out);
    void (*to_planes)(const float* pixels, int channels, int width, float* out, std::size_t plane);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::encoder
