// Work on bands of rows, for the forward and the backward pass. All threads compute one map of all images before any
// thread begins with the next map.
#pragma once

#include <algorithm>
#include <cstddef>

#include "common/team.h"
#include "encoder/cpu/loops.h"
#include "encoder/cpu/weights.h"
#include "encoder/maps.h"

namespace fourd::encoder {

constexpr int kBandRows = 8;
constexpr std::size_t kGroupFloats = std::size_t{16} << 20;

// The number of images that are processed together, so that their maps take at most about 64 MiB.
inline int images_per_group(int images, std::size_t floats_per_image) {
    const std::size_t fitting = kGroupFloats / std::max<std::size_t>(1, floats_per_image);
    return static_cast<int>(std::clamp<std::size_t>(fitting, 1, std::max(images, 1)));
}

// Calls work(image, from, to, worker) for all bands of rows of a level, in all images.
template <typename Work>
void for_bands(Team& team, int images, const Level& level, const Work& work) {
    const int bands = (level.height + kBandRows - 1) / kBandRows;
    team.run(images * bands, [&](int task, int worker) {
        const int from = task % bands * kBandRows;
        work(task / bands, from, std::min(from + kBandRows, level.height), worker);
    });
}

// Sets the zeros around the rows [from, to) of all channels, and the gap after the map.
inline void close_rows(const Map& map, int from, int to) {
    const Level& level = map.level;
    for (int c = 0; c < map.channels; ++c) {
        float* plane = map.plane(c);
        for (int y = from; y < to; ++y) plane[level.row(y) + level.width] = 0.0f;
        if (from == 0) std::fill_n(plane, level.row(0), 0.0f);
        if (to == level.height) std::fill(plane + level.row(to) - 1, plane + level.plane(), 0.0f);
    }
    if (to == level.height) std::fill_n(map.plane(map.channels), kGap, 0.0f);
}

// What happens to the sums of a convolution.
struct Finish {
    const float* bias = nullptr;
    const Map* mask = nullptr;
    bool rectifies = false;
    bool is_band_input = false;  // The same task has computed the input, of which other rows may not be complete.
};

// Computes the rows [from, to) of a convolution whose input and output have the same size.
inline void convolve_rows(const Loops& loops, const TapList& taps, const Map& in, const Map& out, int from, int to,
                          const Finish& finish) {
    const std::size_t at = out.level.row(from);
    const float* mask = finish.mask ? finish.mask->data + at : nullptr;
    loops.convolve({in.data + at, taps.taps(), finish.bias, out.data + at, out.level.plane(), taps.channels(), mask,
                    finish.rectifies, finish.is_band_input},
                   out.level.span(from, to));
    close_rows(out, from, to);
}

}  // namespace fourd::encoder
