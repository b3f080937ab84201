// Forward and backward pass of one block of points. Matrix products process the outputs of a layer in the lanes of a
// vector; the remaining computations process points in the lanes.
#include "heads/cpu/loops.h"

#include <cmath>
#include <cstring>

#include "common/inline.h"
#include "heads/maths.h"
#include "shade/maths.h"

namespace fourd::heads::FOURD_SIMD {
namespace {

#include "heads/cpu/gemm.h"

using shade::fast_tanh;

FOURD_INLINE float sigmoid(float x) { return 0.5f + 0.5f * fast_tanh(0.5f * x); }

constexpr float kOne = 1.0f;

// A "matrix" of ones, with which add_product sums the rows of another matrix.
constexpr Strided ones() { return {&kOne, 0, 0}; }

inline Strided rows_of(const float* at, std::size_t step) { return {at, step, 1}; }
inline Strided columns_of(const float* at, std::size_t step) { return {at, 1, step}; }

inline void fill_rows(const float* row, int width, int count, float* to, std::size_t step) {
    for (int i = 0; i < count; ++i) std::memcpy(to + i * step, row, width * sizeof(float));
}

inline void clear(float* to, std::size_t size) { std::memset(to, 0, size * sizeof(float)); }

inline void rectify(float* values, int width, int count, std::size_t step) {
    for (int i = 0; i < count; ++i) {
        float* row = values + i * step;
        for (int h = 0; h < width; ++h) row[h] = row[h] > 0.0f ? row[h] : 0.0f;
    }
}

// Sets the gradient to 0 where the rectified value is 0.
inline void rectify_backward(const float* values, std::size_t step, int width, int count, float* gradient,
                             std::size_t gradient_step) {
    for (int i = 0; i < count; ++i) {
        const float* row = values + i * step;
        float* to = gradient + i * gradient_step;
        for (int h = 0; h < width; ++h) to[h] = row[h] > 0.0f ? to[h] : 0.0f;
    }
}

// Copies rows of `width` floats into rows that are padded with zeros.
inline void load_rows(const float* from, int width, int count, float* to, int step) {
    for (int i = 0; i < count; ++i) {
        std::memcpy(to + static_cast<std::size_t>(i) * step, from + static_cast<std::size_t>(i) * width,
                    width * sizeof(float));
        for (int k = width; k < step; ++k) to[static_cast<std::size_t>(i) * step + k] = 0.0f;
    }
}

// Reads `count` values of every channel. The rest of the block is set to zero.
inline void load_channels(const float* from, std::size_t from_step, int channels, int count, float* to) {
    for (int c = 0; c < channels; ++c, from += from_step, to += kBlock) {
        std::memcpy(to, from, count * sizeof(float));
        for (int i = count; i < kBlock; ++i) to[i] = 0.0f;
    }
}

// The names of the sizes that most functions need.
struct Shapes {
    const Sizes& sizes;
    int hidden, first, features, channels;

    explicit Shapes(const Sizes& from)
        : sizes(from),
          hidden(from.hidden_stride()),
          first(from.first_stride()),
          features(padded(from.features)),
          channels(padded(from.channels)) {}
};

// Computes the second and the last layer of the geometry head from the rectified first layer.
inline void geometry_layers(const Job& job, const Workspace& space, const Shapes& at, int count) {
    const Packed& packed = *job.packed;
    fill_rows(packed.second_bias, at.hidden, count, space.second, at.hidden);
    add_product(rows_of(space.first, at.first), count, packed.second_columns, at.hidden, at.sizes.hidden, space.second,
                at.hidden, at.hidden);
    rectify(space.second, at.hidden, count, at.hidden);
    fill_rows(packed.last_bias, kPad, count, space.last, kPad);
    add_product(rows_of(space.second, at.hidden), count, packed.last_columns, kPad, at.sizes.hidden, space.last, kPad,
                kPad);
}

#include "heads/cpu/blend.h"

// The viewing directions of a block, with the lengths of the vectors that they normalise.
struct Directions {
    float x[kBlock], y[kBlock], z[kBlock], length[kBlock];
};

inline void directions_of(const Job& job, std::size_t first, int count, Directions* out) {
    const float* centre = job.settings->centre;
    for (int i = 0; i < kBlock; ++i) {
        const float* at = job.inputs->xyz + 3 * (first + (i < count ? i : 0));
        const float x = at[0] - centre[0], y = at[1] - centre[1], z = at[2] - centre[2];
        const float length = std::sqrt(x * x + y * y + z * z);
        out->length[i] = length > 1e-12f ? length : 1e-12f;
        out->x[i] = x / out->length[i], out->y[i] = y / out->length[i], out->z[i] = z / out->length[i];
    }
}

// Evaluates the SH functions, and tanh of the sums of coefficients times functions: space.basis and space.tanhs.
inline void sh_colours(const Workspace& space, const Directions& directions, int count) {
    for (int i = 0; i < kBlock; ++i) {
        shade::harmonics(directions.x[i], directions.y[i], directions.z[i],
                         [&](int k, float value) FOURD_INLINE_LAMBDA { space.basis[k * kBlock + i] = value; });
    }
    for (int c = 0; c < 3; ++c) {
        float sums[kBlock] = {};
        for (int i = 0; i < count; ++i) {
            const float* sh = space.sh + i * kSh + c * kShTerms;
            float sum = 0.0f;
            for (int k = 0; k < kShTerms; ++k) sum += sh[k] * space.basis[k * kBlock + i];
            sums[i] = sum;
        }
        for (int i = 0; i < kBlock; ++i) space.tanhs[c * kBlock + i] = fast_tanh(sums[i]);
    }
}

void forward(const Job& job, const Workspace& space, std::size_t first, int count, const Outputs& out) {
    const Shapes at(*job.sizes);
    const Packed& packed = *job.packed;
    const Settings& settings = *job.settings;
    load_rows(job.inputs->features + first * at.sizes.features, at.sizes.features, count, space.features, at.features);
    fill_rows(packed.first_bias, at.first, count, space.first, at.first);
    add_product(rows_of(space.features, at.features), count, packed.first_columns, at.first, at.sizes.features,
                space.first, at.first, at.first);
    std::memcpy(out.hidden + first * at.first, space.first, sizeof(float) * count * at.first);
    rectify(space.first, at.hidden, count, at.first);
    rectify(space.first + 2 * at.hidden, at.hidden, count, at.first);

    geometry_layers(job, space, at, count);
    for (int i = 0; i < count; ++i) {
        const float share = sigmoid(space.last[i * kPad] + settings.radius_offset);
        const float radius = settings.radius_low + (settings.radius_high - settings.radius_low) * share;
        out.radius[first + i] = radius * job.inputs->spacing[first + i];
        out.density[first + i] = sigmoid(space.last[i * kPad + 1] + settings.density_offset);
    }

    fill_rows(packed.sh_bias, kSh, count, space.sh, kSh);
    add_product(rows_of(space.first + 2 * at.hidden, at.first), count, packed.sh_columns, kSh, at.sizes.hidden,
                space.sh, kSh, kSh);
    std::memcpy(out.sh + first * kSh, space.sh, sizeof(float) * count * kSh);

    float colour[3 * kBlock], is_seen[kBlock];
    blend_views(job, space, at, first, count, space.first + at.hidden);
    blend_weights(job, space, first, count, is_seen);
    blended_colour(job, space, first, count, colour);
    Directions directions;
    directions_of(job, first, count, &directions);
    sh_colours(space, directions, count);
    for (int i = 0; i < count; ++i) {
        for (int c = 0; c < 3; ++c) {
            out.colour[3 * (first + i) + c] = colour[c * kBlock + i] + settings.sh_range * space.tanhs[c * kBlock + i];
        }
    }
}

// Computes the gradient of the geometry head's outputs and layers. Writes the gradient of its first layer.
inline void geometry_backward(const Job& job, const Workspace& space, const Shapes& at, std::size_t first, int count,
                              const Upstream& upstream, const Sums& sums) {
    const Packed& packed = *job.packed;
    const Settings& settings = *job.settings;
    const int hidden = at.sizes.hidden;
    for (int i = 0; i < count; ++i) {
        const float share = sigmoid(space.last[i * kPad] + settings.radius_offset);
        const float density = sigmoid(space.last[i * kPad + 1] + settings.density_offset);
        const float range = (settings.radius_high - settings.radius_low) * job.inputs->spacing[first + i];
        space.last[i * kPad] = upstream.radius[first + i] * range * share * (1.0f - share);
        space.last[i * kPad + 1] = upstream.density[first + i] * density * (1.0f - density);
    }
    add_product(columns_of(space.last, kPad), 2, space.second, at.hidden, count, sums.last, at.hidden, at.hidden);
    add_product(ones(), 1, space.last, kPad, count, sums.last_bias, kPad, kPad);
    clear(space.back, static_cast<std::size_t>(count) * at.hidden);
    add_product(rows_of(space.last, kPad), count, packed.last, at.hidden, 2, space.back, at.hidden, at.hidden);
    rectify_backward(space.second, at.hidden, at.hidden, count, space.back, at.hidden);
    add_product(columns_of(space.back, at.hidden), hidden, space.first, at.first, count, sums.second, at.hidden,
                at.hidden);
    add_product(ones(), 1, space.back, at.hidden, count, sums.second_bias, at.hidden, at.hidden);
    for (int i = 0; i < count; ++i) clear(space.grad_first + static_cast<std::size_t>(i) * at.first, at.hidden);
    add_product(rows_of(space.back, at.hidden), count, packed.second, at.hidden, hidden, space.grad_first, at.first,
                at.hidden);
    rectify_backward(space.first, at.first, at.hidden, count, space.grad_first, at.first);
}

// Computes the gradients of the SH head, and of the positions through the viewing directions. Reads space.tanhs and
// space.basis.
inline void sh_backward(const Job& job, const Workspace& space, const Shapes& at, const Directions& directions,
                        std::size_t first, int count, const Upstream& upstream, const Gradients& out,
                        const Sums& sums) {
    float to_basis[kShTerms * kBlock] = {};
    for (int i = 0; i < count; ++i) {
        for (int c = 0; c < 3; ++c) {
            const float tanh = space.tanhs[c * kBlock + i];
            const float to_sum = space.grad_colour[c * kBlock + i] * job.settings->sh_range * (1.0f - tanh * tanh);
            const float* sh = space.sh + i * kSh + c * kShTerms;
            float* to = space.grad_sh + i * kSh + c * kShTerms;
            for (int k = 0; k < kShTerms; ++k) to[k] = to_sum * space.basis[k * kBlock + i];
            for (int k = 0; k < kShTerms; ++k) to_basis[k * kBlock + i] += to_sum * sh[k];
        }
        if (upstream.sh) {
            const float* from = upstream.sh + (first + i) * kSh;
            for (int k = 0; k < kSh; ++k) space.grad_sh[i * kSh + k] += from[k];
        }
    }
    for (int i = 0; i < count; ++i) {
        const float x = directions.x[i], y = directions.y[i], z = directions.z[i];
        float gx, gy, gz;
        sh_basis_backward(x, y, z, to_basis + i, kBlock, &gx, &gy, &gz);
        const float along = x * gx + y * gy + z * gz;
        float* to = out.xyz + 3 * (first + i);
        to[0] = (gx - x * along) / directions.length[i];
        to[1] = (gy - y * along) / directions.length[i];
        to[2] = (gz - z * along) / directions.length[i];
    }
    const float* hidden = space.first + 2 * at.hidden;
    float* to = space.grad_first + 2 * at.hidden;
    add_product(columns_of(space.grad_sh, kSh), kSh, hidden, at.first, count, sums.sh, at.hidden, at.hidden);
    add_product(ones(), 1, space.grad_sh, kSh, count, sums.sh_bias, kSh, kSh);
    for (int i = 0; i < count; ++i) clear(to + static_cast<std::size_t>(i) * at.first, at.hidden);
    add_product(rows_of(space.grad_sh, kSh), count, job.packed->sh, at.hidden, kSh, to, at.first, at.hidden);
    rectify_backward(hidden, at.first, at.hidden, count, to, at.first);
}

void backward(const Job& job, const Workspace& space, std::size_t first, int count, const Upstream& upstream,
              const Gradients& out, const Sums& sums) {
    const Shapes at(*job.sizes);
    const Packed& packed = *job.packed;
    load_rows(job.inputs->features + first * at.sizes.features, at.sizes.features, count, space.features, at.features);
    std::memcpy(space.first, upstream.hidden + first * at.first, sizeof(float) * count * at.first);
    rectify(space.first, at.hidden, count, at.first);
    rectify(space.first + 2 * at.hidden, at.hidden, count, at.first);
    for (int c = 0; c < 3; ++c) {
        for (int i = 0; i < kBlock; ++i) {
            space.grad_colour[c * kBlock + i] = i < count ? upstream.colour[3 * (first + i) + c] : 0.0f;
        }
    }

    geometry_layers(job, space, at, count);
    geometry_backward(job, space, at, first, count, upstream, sums);

    fill_rows(packed.sh_bias, kSh, count, space.sh, kSh);
    add_product(rows_of(space.first + 2 * at.hidden, at.first), count, packed.sh_columns, kSh, at.sizes.hidden,
                space.sh, kSh, kSh);
    Directions directions;
    directions_of(job, first, count, &directions);
    sh_colours(space, directions, count);
    sh_backward(job, space, at, directions, first, count, upstream, out, sums);

    float is_seen[kBlock];
    blend_views(job, space, at, first, count, space.first + at.hidden);
    blend_weights(job, space, first, count, is_seen);
    blend_weights_backward(job, space, first, count, is_seen, out);
    blend_backward(job, space, at, first, count, out, sums);

    add_product(columns_of(space.grad_first, at.first), at.first, space.features, at.features, count, sums.first,
                at.features, at.features);
    add_product(ones(), 1, space.grad_first, at.first, count, sums.first_bias, at.first, at.first);
    clear(space.wide, static_cast<std::size_t>(count) * at.features);
    add_product(rows_of(space.grad_first, at.first), count, packed.first, at.features, at.first, space.wide,
                at.features, at.features);
    for (int i = 0; i < count; ++i) {
        std::memcpy(out.features + (first + i) * at.sizes.features,
                    space.wide + static_cast<std::size_t>(i) * at.features, at.sizes.features * sizeof(float));
    }
}

}  // namespace

const Loops loops = {forward, backward};

}  // namespace fourd::heads::FOURD_SIMD
