// Trilinear lookup in a level of a multi-resolution hash grid, shared by every backend (Mueller et al. 2022, Instant
// Neural Graphics Primitives, sec. 3).
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::hashgrid {

constexpr int kMaxLevels = 32;
// Number of corners per cell. Bits 0, 1 and 2 of the index of a corner select the upper side in x, y and z.
constexpr int kCorners = 8;

// Each level starts at a multiple of kAlign entries, which is the start of a cache line.
constexpr std::size_t kAlign = 16;

// A level has (resolution + 1)^3 grid vertices on [0, 1]^3. The entries of the level start at index `first` of the
// table. Each vertex has its own entry if there are enough entries. Otherwise, a spatial hash assigns vertices to
// entries.
struct Level {
    std::size_t first;
    std::uint32_t entries;    // Number of entries, which is a power of two if the level is hashed.
    std::uint32_t stride[3];  // For each axis, the factor by which callers of entry_of multiply the vertex index.
    int resolution;
    bool hashed;
};

// Returns the number of vertices of a level with `resolution` cells per side.
FOURD_HD static FOURD_INLINE std::uint64_t samples_of(int resolution) {
    const std::uint64_t side = static_cast<std::uint64_t>(resolution) + 1;
    return side * side * side;
}

// Describes a level, which has at most 2^log2_entries entries. The earlier levels occupy the first `before` entries of
// the table, and padding may follow these entries.
FOURD_HD static FOURD_INLINE Level level_of(int resolution, int log2_entries, std::size_t before) {
    const std::size_t first = (before + kAlign - 1) / kAlign * kAlign;
    const std::uint32_t side = static_cast<std::uint32_t>(resolution) + 1, max_entries = 1u << log2_entries;
    const std::uint64_t samples = samples_of(resolution);
    if (samples <= max_entries) {
        return {first, static_cast<std::uint32_t>(samples), {1u, side, side * side}, resolution, false};
    }
    return {first, max_entries, {1u, 2654435761u, 805459861u}, resolution, true};
}

// The linear interpolation between the two grid vertices around a coordinate. The vertex with the index `low` has the
// weight 1 - fraction, and the next vertex has the weight `fraction`.
struct Interpolation {
    std::uint32_t low;
    float fraction;
    float slope;  // Vertices per unit of the coordinate, or 0 if the coordinate was clamped.
};

// Finds the two grid vertices around a coordinate. NaN counts as 0.
FOURD_HD static FOURD_INLINE Interpolation interpolate_axis(const Level& level, float coordinate) {
    const float size = static_cast<float>(level.resolution);
    const bool inside = coordinate >= 0.0f && coordinate <= 1.0f;
    float clamped = coordinate > 0.0f ? coordinate : 0.0f;
    clamped = clamped < 1.0f ? clamped : 1.0f;
    const float position = clamped * size;
    int low = static_cast<int>(position);
    low = low < level.resolution - 1 ? low : level.resolution - 1;
    return {static_cast<std::uint32_t>(low), position - static_cast<float>(low), inside ? size : 0.0f};
}

// Returns the index of a vertex's entry, relative to the first entry of the level. x, y and z are the indices of the
// vertex along the three axes, each multiplied by the element of level.stride for its axis.
FOURD_HD static FOURD_INLINE std::uint32_t entry_of(const Level& level, std::uint32_t x, std::uint32_t y,
                                                    std::uint32_t z) {
    return level.hashed ? (x ^ y ^ z) & (level.entries - 1u) : x + y + z;
}

// The grid cell that contains a point, with eight corners. Corners 2e and 2e + 1 form edge e, which is parallel to x.
// Their interpolation weights are weight[e] * (1 - fraction) and weight[e] * fraction.
struct Cell {
    std::uint32_t entry[kCorners];
    float weight[kCorners / 2];
    float fraction;
};

FOURD_HD static FOURD_INLINE Cell cell_of(const Level& level, const Interpolation& x, const Interpolation& y,
                                          const Interpolation& z) {
    Cell out;
    const std::uint32_t at_x = x.low * level.stride[0], at_y = y.low * level.stride[1], at_z = z.low * level.stride[2];
    for (int corner = 0; corner < kCorners; ++corner) {
        const std::uint32_t sample_x = at_x + (corner & 1 ? level.stride[0] : 0u),
                            sample_y = at_y + (corner & 2 ? level.stride[1] : 0u),
                            sample_z = at_z + (corner & 4 ? level.stride[2] : 0u);
        out.entry[corner] = entry_of(level, sample_x, sample_y, sample_z);
    }
    for (int edge = 0; edge < kCorners / 2; ++edge) {
        out.weight[edge] = (edge & 1 ? y.fraction : 1.0f - y.fraction) * (edge & 2 ? z.fraction : 1.0f - z.fraction);
    }
    out.fraction = x.fraction;
    return out;
}

// `value` (kCorners,) has one value for each corner of the cell that contains the point `coordinates` (3,). Adds the
// gradient of the trilinearly interpolated value with respect to `coordinates` to `out` (3,).
FOURD_HD static FOURD_INLINE void add_slopes(const Level& level, const float* coordinates, const float* value,
                                             float* out) {
    const Interpolation x = interpolate_axis(level, coordinates[0]), y = interpolate_axis(level, coordinates[1]),
                        z = interpolate_axis(level, coordinates[2]);
    // For each edge along x, compute the difference of the values at its two ends, and the interpolated value.
    float rise[4], mean[4];
    for (int edge = 0; edge < 4; ++edge) {
        rise[edge] = value[2 * edge + 1] - value[2 * edge];
        mean[edge] = value[2 * edge] + x.fraction * rise[edge];
    }
    const float low_z = rise[0] + y.fraction * (rise[1] - rise[0]), high_z = rise[2] + y.fraction * (rise[3] - rise[2]);
    const float low = mean[1] - mean[0], high = mean[3] - mean[2];
    out[0] += x.slope * (low_z + z.fraction * (high_z - low_z));
    out[1] += y.slope * (low + z.fraction * (high - low));
    out[2] += z.slope * ((mean[2] - mean[0]) + y.fraction * (high - low));
}

}  // namespace fourd::hashgrid
