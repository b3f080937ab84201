// Inner loops over batches of points in one source view, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "common/inline.h"
#include "sources/sources.h"

namespace fourd::sources {

constexpr int kRun = 64;  // Number of points per batch. The channels of a batch are transposed in the L1 cache.

FOURD_INLINE std::size_t feature_size(const Maps& maps) {
    return static_cast<std::size_t>(maps.feature_width) * maps.feature_height * maps.channels;
}

struct RunLoops {
    // The functions of RunLoops process points [first, first + count) of one source view.
    void (*sample)(const Query&, std::size_t view, std::size_t first, int count, const Samples& out);
    void (*backward)(const Query&, const float* gradient, std::size_t view, std::size_t first, int count,
                     float* to_features, float* to_xyz);
};

struct Loops {
    RunLoops sixteen_channels;  // Loops for 16 channels, the usual number.
    RunLoops any_channels;

    const RunLoops& of(int channels) const { return channels == 16 ? sixteen_channels : any_channels; }
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::sources
