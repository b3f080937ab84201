// Loops that compute a mip level from the next finer level, and the backward pass of these loops. Only files that are
// compiled once per instruction set (common/dispatch.h) include this file.
#pragma once

#include <cstddef>

#include "common/inline.h"

namespace fourd::texture::FOURD_SIMD {
namespace {

template <int Channels>
FOURD_INLINE void halve_row(const float* top, const float* bottom, int fine_width, int any_channels, float* out) {
    const std::size_t channels = Channels ? Channels : static_cast<std::size_t>(any_channels);
    if (fine_width == 1) {
        for (std::size_t c = 0; c < channels; ++c) out[c] = 0.5f * (top[c] + bottom[c]);
        return;
    }
    for (int x = 0; x < fine_width / 2; ++x, top += 2 * channels, bottom += 2 * channels, out += channels) {
        for (std::size_t c = 0; c < channels; ++c) {
            out[c] = 0.25f * ((top[c] + top[channels + c]) + (bottom[c] + bottom[channels + c]));
        }
    }
}

template <int Channels>
FOURD_INLINE void spread_row(const float* coarse, int fine_width, float share, int any_channels, float* fine) {
    const std::size_t channels = Channels ? Channels : static_cast<std::size_t>(any_channels);
    if (fine_width == 1) {
        for (std::size_t c = 0; c < channels; ++c) fine[c] += share * coarse[c];
        return;
    }
    for (int x = 0; x < fine_width / 2; ++x, coarse += channels, fine += 2 * channels) {
        for (std::size_t c = 0; c < channels; ++c) {
            const float part = share * coarse[c];
            fine[c] += part;
            fine[channels + c] += part;
        }
    }
}

// Computes rows of the coarser level. A texel is the mean of 2 x 2 texels of the finer level, or of two texels if the
// finer level has only one row or one column.
void halve(const float* fine, int fine_width, bool halves_rows, int channels, std::size_t rows, float* out) {
    const std::size_t fine_row = static_cast<std::size_t>(fine_width) * static_cast<std::size_t>(channels);
    const std::size_t row = fine_width == 1 ? fine_row : fine_row / 2;
    with_channels(channels, [&](auto fixed) FOURD_INLINE_LAMBDA {
        for (std::size_t y = 0; y < rows; ++y) {
            const float* top = fine + (halves_rows ? 2 * y : y) * fine_row;
            halve_row<decltype(fixed)::value>(top, halves_rows ? top + fine_row : top, fine_width, channels,
                                              out + y * row);
        }
    });
}

void halve_backward(const float* coarse, int fine_width, bool halves_rows, int channels, std::size_t rows,
                    float* fine) {
    const std::size_t fine_row = static_cast<std::size_t>(fine_width) * static_cast<std::size_t>(channels);
    const std::size_t row = fine_width == 1 ? fine_row : fine_row / 2;
    const float share = (fine_width == 1 ? 1.0f : 0.5f) * (halves_rows ? 0.5f : 1.0f);
    const std::size_t copies = halves_rows ? 2 : 1;
    with_channels(channels, [&](auto fixed) FOURD_INLINE_LAMBDA {
        for (std::size_t y = 0; y < copies * rows; ++y) {
            spread_row<decltype(fixed)::value>(coarse + (y / copies) * row, fine_width, share, channels,
                                               fine + y * fine_row);
        }
    });
}

}  // namespace
}  // namespace fourd::texture::FOURD_SIMD
