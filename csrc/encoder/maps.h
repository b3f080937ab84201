// The feature maps of the image encoder. A map stores its channels as separate planes. A zero separates the rows of a
// plane, and one row of zeros is above and below it, so that a convolution reads zeros outside the map. A convolution is
// therefore a sum of products over one flat range of positions, where each weight has a fixed offset.
#pragma once

#include <cstddef>

#include "encoder/encoder.h"

namespace fourd::encoder {

constexpr std::size_t kLine = 16;        // Floats of a cache line.
constexpr std::size_t kGap = 4 * kLine;  // Floats after a map, because vectors may read beyond its last plane.

// Size of the planes of one level of the pyramid.
struct Level {
    int height, width;

    std::size_t pitch() const { return static_cast<std::size_t>(width) + 1; }

    // Position of the first pixel of a row. Row -1 and row `height` are zeros, and so is the position before the first
    // pixel of each row, which is the position after the last pixel of the row above.
    std::size_t row(int y) const { return static_cast<std::size_t>(y + 1) * pitch() + 1; }

    // Distance between the planes of two channels: an odd number of cache lines, so that the same positions of many
    // planes do not compete for the same lines of the cache.
    std::size_t plane() const {
        const std::size_t lines = (row(height) + pitch() + kLine - 1) / kLine;
        return (lines + 1 - lines % 2) * kLine;
    }

    // Position of the first pixel of row `from`, and number of positions up to the last pixel of row `to` - 1.
    std::size_t span(int from, int to) const { return row(to) - row(from) - 1; }
};

struct Map {
    float* data;
    Level level;
    int channels;

    float* plane(int channel) const { return data + channel * level.plane(); }
    float* row(int channel, int y) const { return plane(channel) + level.row(y); }
};

struct Levels {
    Level full, half, quarter;
};

inline Levels levels_of(const Sizes& sizes) {
    const int height = sizes.out_height(), width = sizes.out_width();
    return {{height, width}, {height / 2, width / 2}, {height / 4, width / 4}};
}

// Divides one block of memory into maps. Without memory, it only counts the floats.
class MapArena {
  public:
    explicit MapArena(float* memory = nullptr) : memory_(memory) {}

    Map take(const Level& level, int channels) {
        const Map out{memory_ ? memory_ + used_ : nullptr, level, channels};
        used_ += channels * level.plane() + kGap;
        return out;
    }
    std::size_t used() const { return used_; }

  private:
    float* memory_;
    std::size_t used_ = 0;
};

// The maps of one image that the gradient reads. The phases of a map are four maps of half its size: the pixels in even
// or odd rows and even or odd columns. A convolution with stride 2 is one with stride 1 over the phases.
struct SavedMaps {
    Map input, full1, full, full_phases, half1, half, half_phases, quarter1, quarter, merged;
};

inline SavedMaps place_saved(const Sizes& sizes, MapArena& arena) {
    const Levels at = levels_of(sizes);
    SavedMaps out;
    out.input = arena.take(at.full, kColours);
    out.full1 = arena.take(at.full, kFull);
    out.full = arena.take(at.full, kFull);
    out.full_phases = arena.take(at.half, 4 * kFull);
    out.half1 = arena.take(at.half, kHalf);
    out.half = arena.take(at.half, kHalf);
    out.half_phases = arena.take(at.quarter, 4 * kHalf);
    out.quarter1 = arena.take(at.quarter, kQuarter);
    out.quarter = arena.take(at.quarter, kQuarter);
    out.merged = arena.take(at.full, kMerged);
    return out;
}

// The other maps of one image in the forward pass: the merged levels, reduced to the channels of kMerged.
struct ForwardMaps {
    Map quarter, half;
};

inline ForwardMaps place_forward(const Sizes& sizes, MapArena& arena) {
    const Levels at = levels_of(sizes);
    ForwardMaps out;
    out.quarter = arena.take(at.quarter, kMerged);
    out.half = arena.take(at.half, kMerged);
    return out;
}

// The gradients of one image's maps. `reduced_` are the gradients of ForwardMaps.
struct GradientMaps {
    Map out, merged, reduced_half, reduced_quarter, quarter, quarter1, half, half1, full, full1;
};

inline int padded_features(const Sizes& sizes) { return (sizes.features + 7) / 8 * 8; }

inline GradientMaps place_gradients(const Sizes& sizes, MapArena& arena) {
    const Levels at = levels_of(sizes);
    GradientMaps out;
    out.out = arena.take(at.full, padded_features(sizes));
    out.merged = arena.take(at.full, kMerged);
    out.reduced_half = arena.take(at.half, kMerged);
    out.reduced_quarter = arena.take(at.quarter, kMerged);
    out.quarter = arena.take(at.quarter, kQuarter);
    out.quarter1 = arena.take(at.quarter, kQuarter);
    out.half = arena.take(at.half, kHalf);
    out.half1 = arena.take(at.half, kHalf);
    out.full = arena.take(at.full, kFull);
    out.full1 = arena.take(at.full, kFull);
    return out;
}

}  // namespace fourd::encoder
