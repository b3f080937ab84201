// Trilinear lookup in a level of a multi-resolution hash grid, the same for every backend (Mueller et al. 2022,
// Instant Neural Graphics Primitives, sec. 3).
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::hashgrid {

constexpr int kMostLevels = 32;
constexpr int kCorners = 8;  // of a cell; bits 0, 1 and 2 of a corner's number say whether it is the far one in x, y, z

constexpr std::size_t kAlign = 16;  // levels begin at a multiple of so many entries, hence at a cache line

// (resolution + 1)^3 samples on [0, 1]^3, kept in entries of the table from first on: each in its own where all fit,
// else where a hash of its place says.
struct Level {
    std::size_t first;
    std::uint32_t entries;  // of hashed levels a power of two
    std::uint32_t step[3];  // a sample's number along an axis times this is the axis' part of its entry
    int resolution;
    bool hashed;
};

// Samples of a level that has so many cells a side.
FOURD_HD static FOURD_INLINE std::uint64_t samples_of(int resolution) {
    const std::uint64_t side = static_cast<std::uint64_t>(resolution) + 1;
    return side * side * side;
}

// The level whose entries follow those before, of which there are so many.
FOURD_HD static FOURD_INLINE Level level_of(int resolution, int log2_entries, std::size_t before) {
    const std::size_t first = (before + kAlign - 1) / kAlign * kAlign;
    const std::uint32_t side = static_cast<std::uint32_t>(resolution) + 1, most = 1u << log2_entries;
    const std::uint64_t samples = samples_of(resolution);
    if (samples <= most) {
        return {first, static_cast<std::uint32_t>(samples), {1u, side, side * side}, resolution, false};
    }
    return {first, most, {1u, 2654435761u, 805459861u}, resolution, true};
}

// Where a coordinate falls between two samples: (1 - share) of the one at low, share of the next.
struct Between {
    std::uint32_t low;
    float share;
    float slope;  // samples per unit of the coordinate; 0 where it was clamped to the border
};

// What is no number counts as 0.
FOURD_HD static FOURD_INLINE Between between(const Level& level, float coordinate) {
    const float size = static_cast<float>(level.resolution);
    const bool inside = coordinate >= 0.0f && coordinate <= 1.0f;
    float clamped = coordinate > 0.0f ? coordinate : 0.0f;
    clamped = clamped < 1.0f ? clamped : 1.0f;
    const float place = clamped * size;
    int low = static_cast<int>(place);
    low = low < level.resolution - 1 ? low : level.resolution - 1;
    return {static_cast<std::uint32_t>(low), place - static_cast<float>(low), inside ? size : 0.0f};
}

// The entry of a sample, counted from the level's first; x, y and z are its parts by axis.
FOURD_HD static FOURD_INLINE std::uint32_t entry_of(const Level& level, std::uint32_t x, std::uint32_t y,
                                                    std::uint32_t z) {
    return level.hashed ? (x ^ y ^ z) & (level.entries - 1u) : x + y + z;
}

// The eight samples around a point. Those of an edge along x, corners 2e and 2e + 1, weigh weight[e], of which the far
// one has the share.
struct Cell {
    std::uint32_t entry[kCorners];
    float weight[kCorners / 2];
    float share;
};

FOURD_HD static FOURD_INLINE Cell cell_of(const Level& level, const Between& x, const Between& y, const Between& z) {
    Cell out;
    const std::uint32_t at_x = x.low * level.step[0], at_y = y.low * level.step[1], at_z = z.low * level.step[2];
    for (int corner = 0; corner < kCorners; ++corner) {
        const std::uint32_t sample_x = at_x + (corner & 1 ? level.step[0] : 0u),
                            sample_y = at_y + (corner & 2 ? level.step[1] : 0u),
                            sample_z = at_z + (corner & 4 ? level.step[2] : 0u);
        out.entry[corner] = entry_of(level, sample_x, sample_y, sample_z);
    }
    for (int edge = 0; edge < kCorners / 2; ++edge) {
        out.weight[edge] = (edge & 1 ? y.share : 1.0f - y.share) * (edge & 2 ? z.share : 1.0f - z.share);
    }
    out.share = x.share;
    return out;
}

// Adds the gradient of a trilinear mean of the corners' values in its coordinates (3) to out (3).
FOURD_HD static FOURD_INLINE void add_slopes(const Level& level, const float* coordinates, const float* value,
                                             float* out) {
    const Between x = between(level, coordinates[0]), y = between(level, coordinates[1]),
                  z = between(level, coordinates[2]);
    float rise[4], mean[4];  // of the edges along x
    for (int edge = 0; edge < 4; ++edge) {
        rise[edge] = value[2 * edge + 1] - value[2 * edge];
        mean[edge] = value[2 * edge] + x.share * rise[edge];
    }
    const float near = rise[0] + y.share * (rise[1] - rise[0]), far = rise[2] + y.share * (rise[3] - rise[2]);
    const float low = mean[1] - mean[0], high = mean[3] - mean[2];
    out[0] += x.slope * (near + z.share * (far - near));
    out[1] += y.slope * (low + z.share * (high - low));
    out[2] += z.slope * ((mean[2] - mean[0]) + y.share * (high - low));
}

}  // namespace fourd::hashgrid
