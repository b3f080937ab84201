#include "texture/cuda/sample.h"

#include "device/clear.h"
#include "device/executor.h"
#include "texture/cuda/lookup.h"

namespace fourd::texture::cuda {
namespace {

FOURD_DEVICE static inline std::size_t picture_of(const Query& query, std::size_t pixel) {
    return pixel / query.pixels;
}

struct Sample {
    Query query;
    float* out;

    FOURD_DEVICE void operator()(std::size_t pixel) const {
        const Lookup at(query, pixel);
        const int channels = query.texture.shape.channels;
        float* to = out + pixel * channels;
        for (int c = 0; c < channels; ++c) to[c] = 0.0f;
        add(at, at.levels.low, 1.0f - at.levels.fraction, picture_of(query, pixel), to);
        if (at.levels.fraction > 0.0f) add(at, at.levels.high, at.levels.fraction, picture_of(query, pixel), to);
    }

  private:
    FOURD_DEVICE void add(const Lookup& at, int level, float blend, std::size_t picture, float* to) const {
        const Texels texels = at.texels(query, level);
        const float* from = query.texture.item(level, picture);
        const int channels = query.texture.shape.channels;
        for (int k = 0; k < 4; ++k) {
            const float* texel = from + static_cast<std::size_t>(texels.index[k]) * channels;
            const float weight = blend * texels.weight[k];
            for (int c = 0; c < channels; ++c) to[c] += weight * texel[c];
        }
    }
};

// The gradients of one pixel with respect to s, t and the mip level.
struct PixelGradient {
    float s, t, level;
};

struct SampleBackward {
    Query query;
    const float* gradient;
    Gradients out;

    FOURD_DEVICE void operator()(std::size_t pixel) const {
        const Lookup at(query, pixel);
        PixelGradient sum = {0.0f, 0.0f, 0.0f};
        add(at, at.levels.low, 1.0f - at.levels.fraction, -1.0f, pixel, sum);
        if (at.levels.is_between) add(at, at.levels.high, at.levels.fraction, 1.0f, pixel, sum);
        if (!at.levels.is_between) sum.level = 0.0f;
        if (out.bias) out.bias[pixel] = sum.level;
        if (query.boundary == Boundary::cube) {
            write_cube(at, sum, pixel);
        } else {
            write(at, sum, pixel);
        }
    }

  private:
    // Adds the contribution of one of the two mip levels that a lookup blends. The derivative with respect to the mip
    // level is the difference of the values of the two levels. `sign` (1 or -1) is the sign that the value of `level`
    // has in this difference.
    FOURD_DEVICE void add(const Lookup& at, int level, float blend, float sign, std::size_t pixel,
                          PixelGradient& sum) const {
        const Texels texels = at.texels(query, level);
        const Shape& shape = query.texture.shape;
        const std::size_t picture = picture_of(query, pixel);
        const float* from = query.texture.item(level, picture);
        float* to = out.levels[level];
        if (to) to += (shape.items == 1 ? 0 : picture) * shape.floats(level);
        for (int k = 0; k < 4; ++k) {
            const std::size_t first = static_cast<std::size_t>(texels.index[k]) * shape.channels;
            const float weight = blend * texels.weight[k];
            float product = 0.0f;
            for (int c = 0; c < shape.channels; ++c) {
                const float g = gradient[pixel * shape.channels + c];
                product += g * from[first + c];
                if (to && weight != 0.0f && g != 0.0f) device::atomic_add(to + first + c, weight * g);
            }
            sum.s += blend * texels.along_s[k] * product;
            sum.t += blend * texels.along_t[k] * product;
            sum.level += sign * texels.weight[k] * product;
        }
    }

    FOURD_DEVICE void write(const Lookup& at, const PixelGradient& sum, std::size_t pixel) const {
        if (out.uv) {
            out.uv[2 * pixel] = sum.s;
            out.uv[2 * pixel + 1] = sum.t;
        }
        if (!out.uv_da) return;
        const bool has_gradient = sum.level != 0.0f;
        const Footprint slopes = has_gradient ? level_slopes(at.footprint) : Footprint{0.0f, 0.0f, 0.0f, 0.0f};
        const float across = sum.level * static_cast<float>(query.texture.shape.width);
        const float down = sum.level * static_cast<float>(query.texture.shape.height);
        float* to = out.uv_da + 4 * pixel;
        to[0] = across * slopes.s_x;
        to[1] = across * slopes.s_y;
        to[2] = down * slopes.t_x;
        to[3] = down * slopes.t_y;
    }

    FOURD_DEVICE void write_cube(const Lookup& at, const PixelGradient& sum, std::size_t pixel) const {
        float to_uv[3] = {0.0f, 0.0f, 0.0f}, to_uv_da[6] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
        cube_position_backward(at.on_cube, sum.s, sum.t, to_uv);
        if (query.uv_da && sum.level != 0.0f) {
            const Footprint slopes = level_slopes(at.footprint);
            const float g = sum.level;
            cube_footprint_backward(at.on_cube, query.uv_da + 6 * pixel, query.texture.shape.width,
                                    {g * slopes.s_x, g * slopes.s_y, g * slopes.t_x, g * slopes.t_y}, to_uv, to_uv_da);
        }
        for (int i = 0; i < 3 && out.uv; ++i) out.uv[3 * pixel + i] = to_uv[i];
        for (int i = 0; i < 6 && out.uv_da; ++i) out.uv_da[6 * pixel + i] = to_uv_da[i];
    }
};

// A channel of a texel of a mip level is the mean of `rows` x `columns` values of the next finer level. Computes the
// offset of the first of these values, the steps to the next column and the next row, and the weight `share` of each
// value. The rows of all faces of all textures are numbered consecutively. Row i of the coarser level is computed from
// the `rows` rows of the finer level that start at row i * rows.
struct Mean {
    std::size_t first, next_column, next_row;
    float share;
    int columns, rows;

    FOURD_DEVICE Mean(const Shape& shape, int level, std::size_t index) {
        const std::size_t width = side_at(shape.width, level), fine_width = side_at(shape.width, level - 1);
        const std::size_t channels = shape.channels, c = index % channels;
        const std::size_t column = index / channels % width, row = index / channels / width;
        columns = fine_width > 1 ? 2 : 1;
        rows = side_at(shape.height, level - 1) > 1 ? 2 : 1;
        first = (row * rows * fine_width + column * columns) * channels + c;
        next_column = channels;
        next_row = fine_width * channels;
        share = 1.0f / static_cast<float>(columns * rows);
    }
};

struct Halve {
    Shape shape;
    int level;
    const float* fine;
    float* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Mean mean(shape, level, index);
        float sum = 0.0f;
        for (int row = 0; row < mean.rows; ++row) {
            for (int column = 0; column < mean.columns; ++column) {
                sum += fine[mean.first + row * mean.next_row + column * mean.next_column];
            }
        }
        out[index] = mean.share * sum;
    }
};

struct HalveBackward {
    Shape shape;
    int level;
    const float* coarse;
    float* fine;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Mean mean(shape, level, index);
        for (int row = 0; row < mean.rows; ++row) {
            for (int column = 0; column < mean.columns; ++column) {
                fine[mean.first + row * mean.next_row + column * mean.next_column] += mean.share * coarse[index];
            }
        }
    }
};

}  // namespace

void sample(const Query& query, float* out, void* stream) {
    device::Executor(stream).for_each(query.pictures * query.pixels, Sample{query, out});
}

void sample_backward(const Query& query, const float* gradient, bool is_chain, const Gradients& out, void* stream) {
    const device::Executor executor(stream);
    const Shape& shape = query.texture.shape;
    for (int level = 0; level < shape.level_count && out.levels[0]; ++level) {
        executor.for_each(shape.items * shape.floats(level), device::Clear{out.levels[level]});
    }
    executor.for_each(query.pictures * query.pixels, SampleBackward{query, gradient, out});
    if (!is_chain || !out.levels[0]) return;
    for (int level = shape.level_count - 1; level > 0; --level) {
        executor.for_each(shape.items * shape.floats(level),
                          HalveBackward{shape, level, out.levels[level], out.levels[level - 1]});
    }
}

void build_mips(const Shape& shape, const float* base, float* const* mips, void* stream) {
    const device::Executor executor(stream);
    for (int level = 1; level < shape.level_count; ++level) {
        const float* const fine = level == 1 ? base : mips[level - 2];
        executor.for_each(shape.items * shape.floats(level), Halve{shape, level, fine, mips[level - 1]});
    }
}

}  // namespace fourd::texture::cuda
