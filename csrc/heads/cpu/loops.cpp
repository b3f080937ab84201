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
inline Strided transposed(const Strided& matrix) { return {matrix.at, matrix.column_step, matrix.row_step}; }

inline void clear(float* to, std::size_t size) { std::memset(to, 0, size * sizeof(float)); }

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

// The values that the forward pass saves for one block: for each point, the first layers (that of the blend head before
// ReLU) and the geometry head's second layer, and after the values of all points the logits of the views.
template <typename Number>
struct SavedBlock {
    Number *rows, *logits;
    std::size_t step;
    int hidden;

    SavedBlock(const Job& job, Number* saved, std::size_t first)
        : rows(saved + first * job.sizes->saved_stride()),
          logits(saved + job.inputs->count * job.sizes->saved_stride() + first),
          step(job.sizes->saved_stride()),
          hidden(job.sizes->hidden_stride()) {}

    Number* geometry() const { return rows; }
    Number* blend() const { return rows + hidden; }
    Number* harmonics() const { return rows + 2 * hidden; }
    Number* second() const { return rows + 3 * hidden; }
};

#include "heads/cpu/mixing.h"
#include "heads/cpu/tables.h"
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

// The sum of the products of two rows of kShTerms numbers.
FOURD_INLINE float sh_dot(const float* a, const float* b) {
    Vector sum = {}, left, right;
FOURD_UNROLL
    for (int k = 0; k < kShTerms; k += kNative) {
        read(a + k, left);
        read(b + k, right);
        multiply_add(left, right, sum);
    }
    return sum_of(sum);
}

// Evaluates the SH functions, and tanh of the sums of coefficients (points, kSh) times functions: space.basis and
// space.tanhs.
inline void sh_colours(const Workspace& space, const Directions& directions, const float* sh, int count) {
    float sums[3 * kBlock] = {};
    for (int i = 0; i < count; ++i) {
        float* basis = space.basis + i * kShTerms;
        shade::harmonics(directions.x[i], directions.y[i], directions.z[i],
                         [&](int k, float value) FOURD_INLINE_LAMBDA { basis[k] = value; });
        for (int c = 0; c < 3; ++c) sums[c * kBlock + i] = sh_dot(sh + i * kSh + c * kShTerms, basis);
    }
    for (int i = 0; i < 3 * kBlock; ++i) space.tanhs[i] = fast_tanh(sums[i]);
}

// Computes the logits of the radius (as a share of its range) and of the density, from the geometry head's second
// layer.
template <int R>
FOURD_INLINE void geometry_logits(const Job& job, const float* second, std::size_t step, float* share,
                                  float* density) {
    const float* weights = job.packed->last;
    const int hidden = job.sizes->hidden_stride();
    Vector shares[R] = {}, densities[R] = {};
    for (int u = 0; u < hidden; u += kNative) {
        Vector value, to_share, to_density;
        read(weights + u, to_share);
        read(weights + hidden + u, to_density);
FOURD_UNROLL
        for (int r = 0; r < R; ++r) {
            read(second + r * step + u, value);
            multiply_add(value, to_share, shares[r]);
            multiply_add(value, to_density, densities[r]);
        }
    }
    const float share_bias = job.packed->last_bias[0] + job.settings->radius_offset;
    const float density_bias = job.packed->last_bias[1] + job.settings->density_offset;
FOURD_UNROLL
    for (int r = 0; r < R; ++r) {
        share[r] = sum_of(shares[r]) + share_bias;
        density[r] = sum_of(densities[r]) + density_bias;
    }
}

// Computes the logits of a block's geometry, with lanes for points, and their sigmoids.
struct Geometry {
    float share[kBlock] = {}, density[kBlock] = {};

    Geometry(const Job& job, const float* second, std::size_t step, int count) {
        int i = 0;
        for (; i + 4 <= count; i += 4) geometry_logits<4>(job, second + i * step, step, share + i, density + i);
        for (; i < count; ++i) geometry_logits<1>(job, second + i * step, step, share + i, density + i);
        for (i = 0; i < kBlock; ++i) share[i] = sigmoid(share[i]);
        for (i = 0; i < kBlock; ++i) density[i] = sigmoid(density[i]);
    }
};

// Computes the layers up to the last ones, into what is saved.
inline void hidden_layers(const Job& job, const Shapes& at, std::size_t first, int count,
                          const SavedBlock<float>& saved) {
    const Packed& packed = *job.packed;
    const std::size_t wide = at.first, narrow = at.hidden;
    const Strided features = rows_of(job.inputs->features + first * at.sizes.features, at.sizes.features);
    if (job.tables) {
        Places places;
        locate(job, first, count, &places);
        interpolate_tables(job, places, count, saved.rows, saved.step);
    }
    const auto layer = [&](int part) FOURD_INLINE_LAMBDA {
        const int column = part * at.hidden;
        const Rows start = job.tables ? Rows{saved.rows + column, saved.step} : Rows{packed.first_bias + column, 0};
        return Product{packed.first_columns + column, wide, at.sizes.features, start, kZeros};
    };
    product<Finish::rectify>(features, count, layer(0), saved.geometry(), saved.step, at.hidden);
    product(features, count, layer(1), saved.blend(), saved.step, at.hidden);
    product<Finish::rectify>(features, count, layer(2), saved.harmonics(), saved.step, at.hidden);
    product<Finish::rectify>(rows_of(saved.geometry(), saved.step), count,
                             {packed.second_columns, narrow, at.sizes.hidden, {packed.second_bias, 0}, kZeros},
                             saved.second(), saved.step, at.hidden);
}

void forward(const Job& job, const Workspace& space, std::size_t first, int count, const Outputs& out) {
    const Shapes at(*job.sizes);
    const Settings& settings = *job.settings;
    const SavedBlock<float> saved(job, out.saved, first);
    hidden_layers(job, at, first, count, saved);

    const Geometry geometry(job, saved.second(), saved.step, count);
    for (int i = 0; i < count; ++i) {
        const float radius = settings.radius_low + (settings.radius_high - settings.radius_low) * geometry.share[i];
        out.radius[first + i] = radius * job.inputs->spacing[first + i];
        out.density[first + i] = geometry.density[i];
    }

    float* sh = out.sh + first * kSh;
    product(rows_of(saved.harmonics(), saved.step), count,
            {job.packed->sh_columns, kSh, at.sizes.hidden, {job.packed->sh_bias, 0}, kZeros}, sh, kSh, kSh);
    Directions directions;
    directions_of(job, first, count, &directions);
    sh_colours(space, directions, sh, count);

    float colour[3 * kBlock], is_seen[kBlock];
    blend_logits(job, {saved.blend(), saved.step}, first, count, saved.logits);
    blend_weights(job, space, first, count, saved.logits, is_seen);
    blended_colour(job, space, first, count, colour);
    for (int i = 0; i < count; ++i) {
        for (int c = 0; c < 3; ++c) {
            out.colour[3 * (first + i) + c] = colour[c * kBlock + i] + settings.sh_range * space.tanhs[c * kBlock + i];
        }
    }
}

// Computes the gradients of the geometry head, and writes the gradient of its first layer.
inline void geometry_backward(const Job& job, const Workspace& space, const Shapes& at,
                              const SavedBlock<const float>& saved, std::size_t first, int count,
                              const Upstream& upstream, const Sums& sums) {
    const Packed& packed = *job.packed;
    const Settings& settings = *job.settings;
    const int hidden = at.sizes.hidden;
    const std::size_t rows = at.hidden;
    const Geometry geometry(job, saved.second(), saved.step, count);
    for (int i = 0; i < count; ++i) {
        const float share = geometry.share[i], density = geometry.density[i];
        const float range = (settings.radius_high - settings.radius_low) * job.inputs->spacing[first + i];
        space.grad_last[i] = upstream.radius[first + i] * range * share * (1.0f - share);
        space.grad_last[kBlock + i] = upstream.density[first + i] * density * (1.0f - density);
        sums.last_bias[0] += space.grad_last[i];
        sums.last_bias[1] += space.grad_last[kBlock + i];
    }
    add_product(rows_of(space.grad_last, kBlock), 2, saved.second(), saved.step, count, sums.last, rows, at.hidden);
    const Rows second{saved.second(), saved.step}, geometry_first{saved.geometry(), saved.step};
    product<Finish::mask>(columns_of(space.grad_last, kBlock), count, {packed.last, rows, 2, kZeros, second},
                          space.back, rows, at.hidden);
    add_product(columns_of(space.back, rows), hidden, saved.geometry(), saved.step, count, sums.second, rows,
                at.hidden);
    add_product(ones(), 1, space.back, rows, count, sums.second_bias, rows, at.hidden);
    product<Finish::mask>(rows_of(space.back, rows), count, {packed.second, rows, hidden, kZeros, geometry_first},
                          space.grad_first, at.first, at.hidden);
}

// Computes the gradients of the SH coefficients, and of the positions through the viewing directions. Reads space.tanhs
// and space.basis.
inline void sh_colours_backward(const Job& job, const Workspace& space, const Directions& directions, const float* sh,
                                std::size_t first, int count, const Upstream& upstream, const Gradients& out) {
    for (int i = 0; i < count; ++i) {
        const float* basis = space.basis + i * kShTerms;
        float to_basis[kShTerms] = {};
        for (int c = 0; c < 3; ++c) {
            const float tanh = space.tanhs[c * kBlock + i];
            const float to_sum = space.grad_colour[c * kBlock + i] * job.settings->sh_range * (1.0f - tanh * tanh);
            const float* from = sh + i * kSh + c * kShTerms;
            float* to = space.grad_sh + i * kSh + c * kShTerms;
            for (int k = 0; k < kShTerms; ++k) to[k] = to_sum * basis[k];
            for (int k = 0; k < kShTerms; ++k) to_basis[k] += to_sum * from[k];
        }
        if (upstream.sh) {
            const float* from = upstream.sh + (first + i) * kSh;
            for (int k = 0; k < kSh; ++k) space.grad_sh[i * kSh + k] += from[k];
        }
        const float x = directions.x[i], y = directions.y[i], z = directions.z[i];
        float gx, gy, gz;
        sh_basis_backward(x, y, z, to_basis, &gx, &gy, &gz);
        const float along = x * gx + y * gy + z * gz;
        float* to = out.xyz + 3 * (first + i);
        to[0] = (gx - x * along) / directions.length[i];
        to[1] = (gy - y * along) / directions.length[i];
        to[2] = (gz - z * along) / directions.length[i];
    }
}

// Computes the gradients of the SH head from those of the coefficients.
inline void sh_backward(const Job& job, const Workspace& space, const Shapes& at, const SavedBlock<const float>& saved,
                        int count, const Sums& sums) {
    const std::size_t rows = at.hidden;
    add_product(columns_of(space.grad_sh, kSh), kSh, saved.harmonics(), saved.step, count, sums.sh, rows, at.hidden);
    add_product(ones(), 1, space.grad_sh, kSh, count, sums.sh_bias, kSh, kSh);
    product<Finish::mask>(rows_of(space.grad_sh, kSh), count,
                          {job.packed->sh, rows, kSh, kZeros, {saved.harmonics(), saved.step}},
                          space.grad_first + 2 * at.hidden, at.first, at.hidden);
}

// Computes the gradients of the first layers and of the features.
inline void first_backward(const Job& job, const Workspace& space, const Shapes& at, std::size_t first, int count,
                           const Gradients& out, const Sums& sums) {
    const std::size_t width = at.sizes.features, wide = at.first;
    add_product(columns_of(job.inputs->features + first * width, width), at.sizes.features, space.grad_first, wide,
                count, sums.first_columns, wide, at.first);
    add_product(ones(), 1, space.grad_first, wide, count, sums.first_bias, wide, at.first);
    if (job.tables) {
        Places places;
        locate(job, first, count, &places);
        scatter_to_tables(job, places, count, space.grad_first, sums.tables);
    }
    product(rows_of(space.grad_first, wide), count,
            {job.packed->first, static_cast<std::size_t>(at.features), at.first, kZeros, kZeros}, space.wide,
            at.features, at.features);
    for (int i = 0; i < count; ++i) {
        std::memcpy(out.features + (first + i) * width, space.wide + static_cast<std::size_t>(i) * at.features,
                    width * sizeof(float));
    }
}

void backward(const Job& job, const Workspace& space, std::size_t first, int count, const Saved& from,
              const Upstream& upstream, const Gradients& out, const Sums& sums) {
    const Shapes at(*job.sizes);
    const SavedBlock<const float> saved(job, from.saved, first);
    const float* sh = from.sh + first * kSh;
    for (int c = 0; c < 3; ++c) {
        for (int i = 0; i < kBlock; ++i) {
            space.grad_colour[c * kBlock + i] = i < count ? upstream.colour[3 * (first + i) + c] : 0.0f;
        }
    }
    geometry_backward(job, space, at, saved, first, count, upstream, sums);

    Directions directions;
    directions_of(job, first, count, &directions);
    sh_colours(space, directions, sh, count);
    sh_colours_backward(job, space, directions, sh, first, count, upstream, out);
    sh_backward(job, space, at, saved, count, sums);

    float is_seen[kBlock];
    blend_weights(job, space, first, count, saved.logits, is_seen);
    blend_weights_backward(job, space, first, count, saved.logits, is_seen, out);
    blend_backward(job, space, at, {saved.blend(), saved.step}, first, count, out, sums);

    first_backward(job, space, at, first, count, out, sums);
}

void multiply(const Factors& factors, float* to) {
    const std::size_t step = factors.a_step, columns = factors.columns;
    const Strided a = factors.is_transposed ? columns_of(factors.a, step) : rows_of(factors.a, step);
    product(a, factors.rows, {factors.b, columns, factors.depth, kZeros, kZeros}, to, columns, factors.columns);
}

}  // namespace

const Loops loops = {forward, backward, multiply};

}  // namespace fourd::heads::FOURD_SIMD
