// An entry is a pixel that reads texels of a band (consecutive texels of a mip level). This file lists entries and sums
// their gradients. Only files that are compiled once per instruction set (common/dispatch.h) include this file.
#pragma once

#include <cstring>

#include "common/inline.h"
#include "texture/cpu/batch.h"
#include "texture/cpu/loops.h"

namespace fourd::texture::FOURD_SIMD {
namespace {

FOURD_INLINE bool is_zero(const float* values, std::size_t count) {
    bool is_zero = true;
    for (std::size_t c = 0; c < count; ++c) is_zero = is_zero && values[c] == 0.0f;
    return is_zero;
}

// The bands of the four texels of each pixel, in one level.
struct BatchBands {
    std::uint32_t band[4][kRun];
    int differs[kRun];  // 0 if the four bands are equal.
};

FOURD_INLINE void find_bands(const Batch& b, int slot, const Bands& bands, BatchBands& out) {
    for (int i = 0; i < b.count; ++i) {
        const int level = b.slot_level[slot][i], shift = bands.shift[level], first = bands.first[level];
        std::uint32_t band[4];
        for (int k = 0; k < 4; ++k) {
            band[k] = static_cast<std::uint32_t>(first + (b.texels[slot].index[k][i] >> shift));
            out.band[k][i] = band[k];
        }
        out.differs[i] = static_cast<int>((band[0] ^ band[1]) | (band[0] ^ band[2]) | (band[0] ^ band[3]));
    }
}

FOURD_INLINE void append(EntryList& list, std::uint32_t band, Entry entry) {
    list.bands[list.count] = band;
    list.entries[list.count++] = entry;
}

// Appends the entries of a batch to `list`: for each pixel with a nonzero gradient, one entry per band from which the
// pixel reads texels. `first` is the index of the batch's first pixel in its task.
FOURD_INLINE void list_entries(const Query& query, const Batch& b, const float* gradient, const Bands& bands, int first,
                               EntryList& list) {
    const std::size_t channels = static_cast<std::size_t>(query.texture.shape.channels);
    bool is_listed[kRun];
    for (int i = 0; i < b.count; ++i) {
        is_listed[i] = b.is_used[i] != 0.0f && !is_zero(gradient + static_cast<std::size_t>(i) * channels, channels);
    }
    const int slots = slots_of(query);
    for (int slot = 0; slot < slots; ++slot) {
        BatchBands at;
        find_bands(b, slot, bands, at);
        for (int i = 0; i < b.count; ++i) {
            if (!is_listed[i] || b.blend[slot][i] == 0.0f) continue;
            const Entry entry = static_cast<Entry>(2 * (first + i) + slot);
            append(list, at.band[0][i], entry);
            if (at.differs[i] == 0) continue;
            const std::uint32_t band[4] = {at.band[0][i], at.band[1][i], at.band[2][i], at.band[3][i]};
            if (band[1] != band[0]) append(list, band[1], entry);
            if (band[2] != band[0] && band[2] != band[1]) append(list, band[2], entry);
            if (band[3] != band[0] && band[3] != band[1] && band[3] != band[2]) append(list, band[3], entry);
        }
    }
}

// Prefetches the memory that the next batch of entries reads. `first` is the index of the task's first pixel among the
// pixels of all pictures.
FOURD_INLINE void prefetch_entries(const Query& query, std::size_t first, const Entry* entries, std::size_t count,
                                   const float* gradient, const float* levels) {
    const std::size_t channels = static_cast<std::size_t>(query.texture.shape.channels);
    const std::size_t coordinates = query.boundary == Boundary::cube ? 3 : 2;
    count = count < kRun ? count : kRun;
    for (std::size_t i = 0; i < count; ++i) {
        const std::size_t pixel = first + entries[i] / 2;
        prefetch(query.uv + coordinates * pixel);
        prefetch(gradient + channels * pixel);
        if (levels) prefetch(levels + pixel);
    }
}

// Gathers the texture coordinates and mip levels of the first b.count entries into `b`, and finds their texels.
template <Boundary boundary>
FOURD_INLINE void prepare_entries(const Query& query, std::size_t first, const Entry* entries, const float* levels,
                                  int level, Batch& b) {
    const std::size_t coordinates = boundary == Boundary::cube ? 3 : 2;
    for (int i = 0; i < b.count; ++i) {
        const float* uv = query.uv + coordinates * (first + entries[i] / 2);
        for (std::size_t axis = 0; axis < coordinates; ++axis) b.uv[axis][i] = uv[axis];
    }
    locate<boundary>(b);
    if (uses_mips(query.filter)) {
        for (int i = 0; i < b.count; ++i) b.level[i] = levels[first + entries[i] / 2];
        choose_levels(query, b);
        for (int i = 0; i < b.count; ++i) b.blend[0][i] = entries[i] % 2 ? b.blend[1][i] : b.blend[0][i];
        for (int i = 0; i < b.count; ++i) b.slot_level[0][i] = level;
    } else {
        use_base_level(b);
    }
    find_texels<boundary, false>(query, b, 0);
    blend_weights(b, 0);
}

#if defined(__GNUC__)
typedef float Four __attribute__((vector_size(16)));
#else
struct Four {
    float value[4];
};
#endif

// Adds weight * from to the four floats of `to`.
FOURD_INLINE void add_four(const Four& from, float weight, float* to) {
#if defined(__GNUC__)
    Four sum;
    std::memcpy(&sum, to, sizeof sum);
    sum += from * weight;
    std::memcpy(to, &sum, sizeof sum);
#else
    for (int c = 0; c < 4; ++c) to[c] += weight * from.value[c];
#endif
}

// Adds the contributions of the entries to the gradient sums of the band's texels. The pixel of an entry reads four
// texels of the mip level, and at least one of them is in the band. To the sum of each of the four texels that is in
// the band, the function adds the gradient of the pixel times the weight with which the pixel reads the texel. The
// other texels are skipped.
template <int Channels>
FOURD_INLINE void add_entries(const Query& query, const Batch& b, std::size_t first, const Entry* entries,
                              const float* gradient, const BandSums& band) {
    constexpr bool kIsVector = Channels == 3 || Channels == 4;
    const std::size_t channels = Channels ? Channels : static_cast<std::size_t>(query.texture.shape.channels);
    const std::size_t stride = Channels == 3 ? 4 : channels;
    const unsigned texels = static_cast<unsigned>(band.end - band.begin);
    for (int i = 0; i < b.count; ++i) {
        const float* from = gradient + (first + entries[i] / 2) * channels;
        Four four = {};
        if (kIsVector) four = Four{from[0], from[1], from[2], Channels == 4 ? from[3] : 0.0f};
        for (int k = 0; k < 4; ++k) {
            const unsigned index = static_cast<unsigned>(b.texels[0].index[k][i] - band.begin);
            if (index >= texels) continue;
            float* to = band.sums + index * stride;
            const float weight = b.texels[0].weight[k][i];
            if (kIsVector) {
                add_four(four, weight, to);
            } else {
                for (std::size_t c = 0; c < stride; ++c) to[c] += weight * from[c];
            }
        }
    }
}

}  // namespace
}  // namespace fourd::texture::FOURD_SIMD
