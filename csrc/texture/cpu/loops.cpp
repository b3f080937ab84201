#include "texture/cpu/loops.h"

#include <cstring>

#include "texture/cpu/batch.h"
#include "texture/cpu/entries.h"
#include "texture/cpu/mips.h"

namespace fourd::texture::FOURD_SIMD {
namespace {

// Loads the coordinates of consecutive pixels. `uv` points to the coordinates of the first pixel.
FOURD_INLINE void load_uv(Batch& b, const float* uv, int coordinates) {
    for (int axis = 0; axis < coordinates; ++axis) {
        for (int i = 0; i < b.count; ++i) b.uv[axis][i] = uv[coordinates * i + axis];
    }
}

// Finds the levels and texels of `count` consecutive pixels. `pixel` is the index of the first pixel among the pixels
// of all pictures.
template <Boundary boundary, bool with_slopes>
FOURD_INLINE void prepare(const Query& query, std::size_t pixel, int count, Batch& b) {
    const int coordinates = boundary == Boundary::cube ? 3 : 2;
    b.count = count;
    load_uv(b, query.uv + coordinates * pixel, coordinates);
    locate<boundary>(b);
    if (uses_mips(query.filter)) {
        find_levels<boundary>(query, b, query.uv_da ? query.uv_da + 2 * coordinates * pixel : nullptr,
                              query.bias ? query.bias + pixel : nullptr);
        choose_levels(query, b);
    } else {
        use_base_level(b);
    }
    for (int slot = 0; slot < slots_of(query); ++slot) find_texels<boundary, with_slopes>(query, b, slot);
}

// For each mip level of the texture that one picture samples, a pointer to the texels of the level.
struct Bases {
    const float* level[kMaxLevels];

    FOURD_INLINE Bases(const Texture& texture, std::size_t picture) {
        for (int k = 0; k < texture.shape.level_count; ++k) {
            level[k] = texture.item(k, picture);
        }
    }
};

// Adds the weighted texels of one level to a pixel. If the number of channels is known at compile time, the sum stays
// in registers.
template <int Channels>
FOURD_INLINE void add_texels(const Batch& b, int slot, int i, const Bases& bases, std::size_t channels, float* sum) {
    const float* level = bases.level[b.slot_level[slot][i]];
    const BatchTexels& texels = b.texels[slot];
    for (int k = 0; k < 4; ++k) {
        const float* from = level + static_cast<std::size_t>(texels.index[k][i]) * channels;
        const float weight = texels.weight[k][i];
        for (std::size_t c = 0; c < (Channels ? Channels : channels); ++c) sum[c] += weight * from[c];
    }
}

template <int Channels>
FOURD_INLINE void write_pixels(const Query& query, const Batch& b, const Bases& bases, float* out) {
    const std::size_t channels = Channels ? Channels : static_cast<std::size_t>(query.texture.shape.channels);
    const bool is_blended = slots_of(query) == 2;
    for (int i = 0; i < b.count; ++i, out += channels) {
        float fixed[Channels ? Channels : 1] = {};
        float* sum = Channels ? fixed : out;
        if (!Channels) std::memset(out, 0, channels * sizeof(float));
        add_texels<Channels>(b, 0, i, bases, channels, sum);
        if (is_blended && b.blend[1][i] != 0.0f) add_texels<Channels>(b, 1, i, bases, channels, sum);
        if (Channels) std::memcpy(out, fixed, channels * sizeof(float));
    }
}

void sample(const Query& query, const Task& task, float* out) {
    const Bases bases(query.texture, task.picture);
    const std::size_t channels = static_cast<std::size_t>(query.texture.shape.channels);
    with_boundary(query.boundary, [&](auto boundary) FOURD_INLINE_LAMBDA {
        Batch b;
        for (int begin = 0; begin < task.count; begin += kRun) {
            const int count = task.count - begin < kRun ? task.count - begin : kRun;
            const std::size_t pixel = task.picture * query.pixels + task.begin + static_cast<std::size_t>(begin);
            prepare<decltype(boundary)::value, false>(query, pixel, count, b);
            for (int slot = 0; slot < slots_of(query); ++slot) blend_weights(b, slot);
            with_channels(query.texture.shape.channels, [&](auto fixed) FOURD_INLINE_LAMBDA {
                write_pixels<decltype(fixed)::value>(query, b, bases, out + pixel * channels);
            });
        }
    });
}

// For each pixel, the dot products of the pixel's gradient with the values of its texels.
struct Products {
    float value[2][4][kRun];
};

template <int Channels>
FOURD_INLINE void multiply_texels(const Query& query, const Batch& b, const Bases& bases, const float* gradient,
                                  Products& out) {
    const std::size_t channels = Channels ? Channels : static_cast<std::size_t>(query.texture.shape.channels);
    const int slots = slots_of(query);
    for (int i = 0; i < b.count; ++i, gradient += channels) {
        for (int slot = 0; slot < slots; ++slot) {
            const float* level = bases.level[b.slot_level[slot][i]];
            for (int k = 0; k < 4; ++k) {
                const float* from = level + static_cast<std::size_t>(b.texels[slot].index[k][i]) * channels;
                float sum = 0.0f;
                for (std::size_t c = 0; c < channels; ++c) sum += gradient[c] * from[c];
                out.value[slot][k][i] = sum;
            }
        }
    }
}

// The gradients of a batch with respect to s, t and the mip level.
struct PositionGradients {
    float s[kRun], t[kRun], level[kRun];
};

FOURD_INLINE void position_gradients(const Query& query, const Batch& b, const Products& products,
                                     PositionGradients& out) {
    for (int i = 0; i < b.count; ++i) out.s[i] = out.t[i] = out.level[i] = 0.0f;
    const int slots = slots_of(query);
    for (int slot = 0; slot < slots; ++slot) {
        const BatchTexels& at = b.texels[slot];
        const float sign = slot == 0 ? -1.0f : 1.0f;
        for (int k = 0; k < 4; ++k) {
            for (int i = 0; i < b.count; ++i) {
                const float blended = b.blend[slot][i] * products.value[slot][k][i];
                out.s[i] += blended * at.along_s[k][i];
                out.t[i] += blended * at.along_t[k][i];
                out.level[i] += (sign * products.value[slot][k][i]) * at.weight[k][i];
            }
        }
    }
    for (int i = 0; i < b.count; ++i) out.level[i] = slots == 2 && b.is_between[i] != 0.0f ? out.level[i] : 0.0f;
}

template <Boundary boundary>
FOURD_INLINE void write_gradients(const Query& query, const Batch& b, const PositionGradients& from, std::size_t pixel,
                                  const Gradients& out) {
    if (out.bias) {
        for (int i = 0; i < b.count; ++i) out.bias[pixel + i] = from.level[i];
    }
    const bool by_level = uses_mips(query.filter) && query.uv_da;
    if (boundary == Boundary::cube) {
        for (int i = 0; i < b.count; ++i) {
            const CubePosition at = cube_position(b.uv[0][i], b.uv[1][i], b.uv[2][i]);
            float to_uv[3] = {}, to_uv_da[6] = {};
            cube_position_backward(at, from.s[i], from.t[i], to_uv);
            if (by_level && from.level[i] != 0.0f) {
                const float* uv_da = query.uv_da + 6 * (pixel + i);
                const int size = query.texture.shape.width;
                const Footprint slopes = level_slopes(cube_footprint(at, uv_da, size));
                const float g = from.level[i];
                const Footprint gradient = {g * slopes.s_x, g * slopes.s_y, g * slopes.t_x, g * slopes.t_y};
                cube_footprint_backward(at, uv_da, size, gradient, to_uv, to_uv_da);
            }
            if (out.uv) std::memcpy(out.uv + 3 * (pixel + i), to_uv, sizeof to_uv);
            if (out.uv_da) std::memcpy(out.uv_da + 6 * (pixel + i), to_uv_da, sizeof to_uv_da);
        }
        return;
    }
    if (out.uv) {
        for (int i = 0; i < b.count; ++i) {
            out.uv[2 * (pixel + i)] = from.s[i];
            out.uv[2 * (pixel + i) + 1] = from.t[i];
        }
    }
    if (!out.uv_da) return;
    if (!by_level) {
        std::memset(out.uv_da + 4 * pixel, 0, 4 * static_cast<std::size_t>(b.count) * sizeof(float));
        return;
    }
    const float width = static_cast<float>(query.texture.shape.width),
                height = static_cast<float>(query.texture.shape.height);
    const float* uv_da = query.uv_da + 4 * pixel;
    float* to = out.uv_da + 4 * pixel;
    for (int i = 0; i < b.count; ++i) {
        const Footprint slopes = level_slopes(footprint_of<boundary>(query, b, uv_da, i));
        const bool has_gradient = from.level[i] != 0.0f;
        const float across = from.level[i] * width, down = from.level[i] * height;
        to[4 * i] = has_gradient ? across * slopes.s_x : 0.0f;
        to[4 * i + 1] = has_gradient ? across * slopes.s_y : 0.0f;
        to[4 * i + 2] = has_gradient ? down * slopes.t_x : 0.0f;
        to[4 * i + 3] = has_gradient ? down * slopes.t_y : 0.0f;
    }
}

void pixel_gradients(const Query& query, const Task& task, const float* gradient, const Gradients& out, float* levels,
                     const Bands& bands, EntryList* entries) {
    const Bases bases(query.texture, task.picture);
    const std::size_t channels = static_cast<std::size_t>(query.texture.shape.channels);
    const bool to_positions = out.uv || out.uv_da || out.bias;
    with_boundary(query.boundary, [&](auto boundary) FOURD_INLINE_LAMBDA {
        constexpr Boundary kBoundary = decltype(boundary)::value;
        Batch b;
        for (int begin = 0; begin < task.count; begin += kRun) {
            const int count = task.count - begin < kRun ? task.count - begin : kRun;
            const std::size_t pixel = task.picture * query.pixels + task.begin + static_cast<std::size_t>(begin);
            const float* from = gradient + pixel * channels;
            prepare<kBoundary, true>(query, pixel, count, b);
            if (levels) std::memcpy(levels + pixel, b.level, b.count * sizeof(float));
            if (to_positions) {
                Products products;
                PositionGradients positions;
                with_channels(query.texture.shape.channels, [&](auto fixed) FOURD_INLINE_LAMBDA {
                    multiply_texels<decltype(fixed)::value>(query, b, bases, from, products);
                });
                position_gradients(query, b, products, positions);
                write_gradients<kBoundary>(query, b, positions, pixel, out);
            }
            if (entries) list_entries(query, b, from, bands, begin, *entries);
        }
    });
}

void scatter(const Query& query, const Task& task, const Entry* entries, std::size_t count, const float* gradient,
             const float* levels, const BandSums& band) {
    const std::size_t first = task.picture * query.pixels + task.begin;
    with_boundary(query.boundary, [&](auto boundary) FOURD_INLINE_LAMBDA {
        Batch b;
        for (std::size_t begin = 0; begin < count; begin += kRun) {
            b.count = static_cast<int>(count - begin < kRun ? count - begin : kRun);
            const Entry* const next = entries + begin + b.count;
            prefetch_entries(query, first, next, count - begin - b.count, gradient, levels);
            prepare_entries<decltype(boundary)::value>(query, first, entries + begin, levels, band.level, b);
            with_channels(query.texture.shape.channels, [&](auto fixed) FOURD_INLINE_LAMBDA {
                add_entries<decltype(fixed)::value>(query, b, first, entries + begin, gradient, band);
            });
        }
    });
}

}  // namespace

const Loops loops = {sample, pixel_gradients, scatter, halve, halve_backward};

}  // namespace fourd::texture::FOURD_SIMD
