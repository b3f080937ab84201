// Computes the positions, mip levels and texels of batches of pixels, in loops that compilers vectorise over pixels.
// Only files that are compiled once per instruction set (common/dispatch.h) include this file.
#pragma once

#include "common/inline.h"
#include "texture/texture.h"

namespace fourd::texture::FOURD_SIMD {
namespace {

constexpr int kRun = 64;  // Number of pixels per batch. A batch stays in the L1 cache.

FOURD_INLINE int slots_of(const Query& query) { return query.filter == Filter::linear_mipmap_linear ? 2 : 1; }

struct BatchTexels {
    int index[4][kRun];
    float weight[4][kRun], along_s[4][kRun], along_t[4][kRun];
};

struct Batch {
    int count;
    float uv[3][kRun];
    int face[kRun];
    float s[kRun], t[kRun];
    float is_used[kRun];  // 0 for positions that are not finite, and 1 for all other positions.
    float level[kRun];    // Clamped mip level.
    int slot_level[2][kRun];
    float blend[2][kRun];  // Weights of the two levels in slot_level.
    float is_between[kRun];
    BatchTexels texels[2];
};

template <Boundary boundary>
FOURD_INLINE void locate(Batch& b) {
    if (boundary == Boundary::cube) {
        for (int i = 0; i < b.count; ++i) {
            const CubePosition at = cube_position(b.uv[0][i], b.uv[1][i], b.uv[2][i]);
            b.face[i] = at.face;
            b.s[i] = at.s;
            b.t[i] = at.t;
            b.is_used[i] = at.is_valid ? 1.0f : 0.0f;
        }
        return;
    }
    for (int i = 0; i < b.count; ++i) {
        const bool is_used = is_finite(b.uv[0][i]) && is_finite(b.uv[1][i]);
        b.face[i] = 0;
        b.s[i] = is_used ? b.uv[0][i] : 0.0f;
        b.t[i] = is_used ? b.uv[1][i] : 0.0f;
        b.is_used[i] = is_used ? 1.0f : 0.0f;
    }
    for (int i = 0; i < b.count; ++i) {
        b.s[i] = wrapped<boundary>(b.s[i]);
        b.t[i] = wrapped<boundary>(b.t[i]);
    }
}

template <Boundary boundary>
FOURD_INLINE Footprint footprint_of(const Query& query, const Batch& b, const float* uv_da, int i) {
    const Shape& shape = query.texture.shape;
    if (boundary == Boundary::cube) {
        const CubePosition at = cube_position(b.uv[0][i], b.uv[1][i], b.uv[2][i]);
        return cube_footprint(at, uv_da + 6 * i, shape.width);
    }
    const float width = static_cast<float>(shape.width), height = static_cast<float>(shape.height);
    const float* d = uv_da + 4 * i;
    return {limited_derivative(d[0] * width), limited_derivative(d[1] * width), limited_derivative(d[2] * height),
            limited_derivative(d[3] * height)};
}

// Computes the clamped mip levels. uv_da and bias point to the values of the batch's first pixel, or are null.
template <Boundary boundary>
FOURD_INLINE void find_levels(const Query& query, Batch& b, const float* uv_da, const float* bias) {
    for (int i = 0; i < b.count; ++i) b.level[i] = 0.0f;
    if (uv_da) {
        for (int i = 0; i < b.count; ++i) b.level[i] = level_of(footprint_of<boundary>(query, b, uv_da, i));
    }
    if (bias) {
        for (int i = 0; i < b.count; ++i) b.level[i] += bias[i];
    }
    const int level_count = query.texture.shape.level_count;
    for (int i = 0; i < b.count; ++i) b.level[i] = clamped_level(b.level[i], level_count);
}

// Chooses the levels and their weights from the clamped mip level.
FOURD_INLINE void choose_levels(const Query& query, Batch& b) {
    const int level_count = query.texture.shape.level_count;
    for (int i = 0; i < b.count; ++i) {
        const Levels at = levels_at(b.level[i], level_count, query.filter);
        b.slot_level[0][i] = at.low;
        b.slot_level[1][i] = at.high;
        b.blend[0][i] = 1.0f - at.fraction;
        b.blend[1][i] = at.fraction;
        b.is_between[i] = at.is_between ? 1.0f : 0.0f;
    }
}

FOURD_INLINE void use_base_level(Batch& b) {
    for (int i = 0; i < b.count; ++i) {
        b.slot_level[0][i] = 0;
        b.blend[0][i] = 1.0f;
    }
}

template <Boundary boundary, bool is_nearest, bool with_slopes>
FOURD_INLINE void find_texels_of(const Query& query, Batch& b, int slot) {
    const int width = query.texture.shape.width, height = query.texture.shape.height;
    BatchTexels& out = b.texels[slot];
    const int* level = b.slot_level[slot];
    for (int i = 0; i < b.count; ++i) {
        const Texels at = texels_at<boundary, is_nearest>(b.face[i], b.s[i], b.t[i], side_at(width, level[i]),
                                                          side_at(height, level[i]), b.is_used[i]);
        for (int k = 0; k < 4; ++k) {
            out.index[k][i] = at.index[k];
            out.weight[k][i] = at.weight[k];
            if (with_slopes) {
                out.along_s[k][i] = at.along_s[k];
                out.along_t[k][i] = at.along_t[k];
            }
        }
    }
}

// Finds the texels of one of the two mip levels that a lookup blends. `with_slopes` states whether the derivatives of
// the weights are needed.
template <Boundary boundary, bool with_slopes>
FOURD_INLINE void find_texels(const Query& query, Batch& b, int slot) {
    if (query.filter == Filter::nearest) {
        find_texels_of<boundary, true, with_slopes>(query, b, slot);
    } else {
        find_texels_of<boundary, false, with_slopes>(query, b, slot);
    }
}

// Multiplies the weights of the texels by the weight of their level.
FOURD_INLINE void blend_weights(Batch& b, int slot) {
    for (int k = 0; k < 4; ++k) {
        for (int i = 0; i < b.count; ++i) b.texels[slot].weight[k][i] *= b.blend[slot][i];
    }
}

// Makes a boundary mode a compile-time constant. with_boundary receives a mode that is known only at run time, and
// calls work(BoundaryTag<mode>()). Inside `work`, the member `value` of this tag is a compile-time constant equal to
// the mode.
template <Boundary boundary>
struct BoundaryTag {
    static constexpr Boundary value = boundary;
};

template <typename Work>
FOURD_INLINE void with_boundary(Boundary boundary, const Work& work) {
    switch (boundary) {
        case Boundary::wrap: return work(BoundaryTag<Boundary::wrap>());
        case Boundary::clamp: return work(BoundaryTag<Boundary::clamp>());
        case Boundary::zero: return work(BoundaryTag<Boundary::zero>());
        case Boundary::cube: return work(BoundaryTag<Boundary::cube>());
    }
}

// Makes the number of channels a compile-time constant, as BoundaryTag does for the boundary mode. The value 0 stands
// for any number other than 1, 3 and 4.
template <int channels>
struct ChannelsTag {
    static constexpr int value = channels;
};

template <typename Work>
FOURD_INLINE void with_channels(int channels, const Work& work) {
    switch (channels) {
        case 1: return work(ChannelsTag<1>());
        case 3: return work(ChannelsTag<3>());
        case 4: return work(ChannelsTag<4>());
        default: return work(ChannelsTag<0>());
    }
}

}  // namespace
}  // namespace fourd::texture::FOURD_SIMD
