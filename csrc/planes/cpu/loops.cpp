// Loops over batches of points, written so that compilers vectorise over features.
#include "planes/cpu/loops.h"

#include <cstring>

#include "common/eight.h"
#include "common/inline.h"

namespace fourd::planes::FOURD_SIMD {
namespace {

constexpr int kPrefetchDistance = 4;  // While point i is processed, point i + kPrefetchDistance is prefetched.

FOURD_INLINE void locate_run(const Plan& plan, std::size_t begin, int count, const RunPositions& out) {
    float coordinates[4][kRun];
    for (int i = 0; i < count; ++i) {
        const float* at = plan.query->coordinates + 4 * static_cast<std::size_t>(plan.order[begin + i]);
        for (int axis = 0; axis < 4; ++axis) coordinates[axis][i] = at[axis];
    }
    for (int axis = 0; axis < plan.axis_count; ++axis) {
        const float* from = coordinates[plan.axes[axis].coordinate];
        const int size = plan.axes[axis].size;
        for (int i = 0; i < count; ++i) {
            const Interpolation position = interpolate_axis(from[i], size);
            out.low[axis * kRun + i] = position.low;
            out.fraction[axis * kRun + i] = position.fraction;
            out.slope[axis * kRun + i] = position.slope;
        }
    }
}

// Prefetches the plane samples that surround point i of a batch, in the planes [first, last). Planes that fit in the
// caches of a core are skipped. `values(k)` returns a pointer to the array of plane k that the caller
// accesses: the values of the plane, or the gradient of these values.
template <typename Values>
FOURD_INLINE void prefetch_samples(const Plan& plan, const RunPositions& positions, int i, int first, int last,
                                   const Values& values) {
    const Query& query = *plan.query;
    const std::size_t pair = 2 * static_cast<std::size_t>(query.features) - 1;
    for (int j = 0; j < plan.large_count; ++j) {
        const int k = plan.large[j];
        if (k < first || k >= last) continue;
        const std::size_t columns = static_cast<std::size_t>(query.planes[k].columns);
        const std::size_t row = static_cast<std::size_t>(positions.low[plan.y_axis[k] * kRun + i]);
        const float* at = values(k) + (row * columns + positions.low[plan.x_axis[k] * kRun + i]) * query.features;
        for (int rows = 0; rows < 2; ++rows, at += columns * query.features) {
            prefetch(at);
            prefetch(at + pair);
        }
    }
}

// Interpolates four samples bilinearly. `top` and `bottom` point to the left samples, and the right samples follow them
// in memory.
template <int Features>
FOURD_INLINE void interpolate(const Corners& c, const float* top, const float* bottom, int features, float* to) {
#if defined(FOURD_EIGHT)
    if (Features == 8) {
        Eight corner[4];
        load(top, corner), load(top + 8, corner + 1), load(bottom, corner + 2), load(bottom + 8, corner + 3);
        const Eight out = (c.weight[0][0] * corner[0] + c.weight[0][1] * corner[1]) +
                          (c.weight[1][0] * corner[2] + c.weight[1][1] * corner[3]);
        std::memcpy(to, &out, sizeof out);
        return;
    }
#endif
    for (int f = 0; f < features; ++f) {
        to[f] = (c.weight[0][0] * top[f] + c.weight[0][1] * top[features + f]) +
                (c.weight[1][0] * bottom[f] + c.weight[1][1] * bottom[features + f]);
    }
}

// Adds the weighted gradient of a point to the gradients of its four samples.
template <int Features>
FOURD_INLINE void scatter_sample(const Corners& c, const float* gradient, int features, float* top, float* bottom) {
#if defined(FOURD_EIGHT)
    if (Features == 8) {
        Eight from, to;
        load(gradient, &from);
        for (int corner = 0; corner < 4; ++corner) {
            float* at = (corner < 2 ? top : bottom) + 8 * (corner % 2);
            load(at, &to);
            to += c.weight[corner / 2][corner % 2] * from;
            std::memcpy(at, &to, sizeof to);
        }
        return;
    }
#endif
    for (int f = 0; f < features; ++f) {
        top[f] += c.weight[0][0] * gradient[f];
        top[features + f] += c.weight[0][1] * gradient[f];
        bottom[f] += c.weight[1][0] * gradient[f];
        bottom[features + f] += c.weight[1][1] * gradient[f];
    }
}

// Computes the contribution of each feature to the gradient with respect to the plane's two coordinates. Adds the
// contributions to along_x (features,) and along_y (features,).
template <int Features>
FOURD_INLINE void add_slopes(const Interpolation& x, const Interpolation& y, const float* gradient, const float* top,
                             const float* bottom, int features, float* along_x, float* along_y) {
#if defined(FOURD_EIGHT)
    if (Features == 8) {
        Eight from, corner[4], to_x, to_y;
        load(gradient, &from);
        load(top, corner), load(top + 8, corner + 1), load(bottom, corner + 2), load(bottom + 8, corner + 3);
        const Eight across = corner[1] - corner[0], down = corner[2] - corner[0];
        const Eight twist = (corner[3] - corner[2]) - across;
        load(along_x, &to_x);
        to_x += x.slope * from * (across + y.fraction * twist);
        std::memcpy(along_x, &to_x, sizeof to_x);
        load(along_y, &to_y);
        to_y += y.slope * from * (down + x.fraction * twist);
        std::memcpy(along_y, &to_y, sizeof to_y);
        return;
    }
#endif
    for (int f = 0; f < features; ++f) {
        const float across = top[features + f] - top[f], down = bottom[f] - top[f];
        const float twist = (bottom[features + f] - bottom[f]) - across;
        along_x[f] += x.slope * gradient[f] * (across + y.fraction * twist);
        along_y[f] += y.slope * gradient[f] * (down + x.fraction * twist);
    }
}

// The template argument Features is the number of features if it is known at compile time. Features is 0 if the number
// is known only at run time.
template <int Features>
FOURD_INLINE void sample_run(const Plan& plan, std::size_t begin, int count, const RunPositions& positions,
                             float* out) {
    const Query& query = *plan.query;
    const int features = Features > 0 ? Features : query.features;
    const std::size_t width = static_cast<std::size_t>(query.plane_count) * features;
    locate_run(plan, begin, count, positions);
    const auto values = [&](int k) FOURD_INLINE_LAMBDA { return query.planes[k].values; };
    for (int i = 0; i < count; ++i) {
        if (i + kPrefetchDistance < count)
            prefetch_samples(plan, positions, i + kPrefetchDistance, 0, query.plane_count, values);
        float* to = out + width * plan.order[begin + i];
        for (int k = 0; k < query.plane_count; ++k, to += features) {
            const Plane& plane = query.planes[k];
            const Corners c =
                corners(plane, positions.at(plan.x_axis[k], i), positions.at(plan.y_axis[k], i), features);
            interpolate<Features>(c, plane.values + c.top, plane.values + c.bottom, features, to);
        }
    }
}

template <int Features>
FOURD_INLINE void coordinate_gradient_run(const Plan& plan, std::size_t begin, int count, const RunPositions& positions,
                                          const float* gradient, float* out) {
    const Query& query = *plan.query;
    const int features = Features > 0 ? Features : query.features;
    const std::size_t width = static_cast<std::size_t>(query.plane_count) * features;
    locate_run(plan, begin, count, positions);
    const auto values = [&](int k) FOURD_INLINE_LAMBDA { return query.planes[k].values; };
    for (int i = 0; i < count; ++i) {
        if (i + kPrefetchDistance < count)
            prefetch_samples(plan, positions, i + kPrefetchDistance, 0, query.plane_count, values);
        const float* from = gradient + width * plan.order[begin + i];
        float total[4][Features > 0 ? Features : kMaxFeatures] = {};  // Indexed by coordinate, then by feature.
        for (int k = 0; k < query.plane_count; ++k, from += features) {
            const Plane& plane = query.planes[k];
            const Interpolation x = positions.at(plan.x_axis[k], i), y = positions.at(plan.y_axis[k], i);
            const Corners c = corners(plane, x, y, features);
            add_slopes<Features>(x, y, from, plane.values + c.top, plane.values + c.bottom, features,
                                 total[plane.x_axis], total[plane.y_axis]);
        }
        float* to = out + 4 * static_cast<std::size_t>(plan.order[begin + i]);
        for (int axis = 0; axis < 4; ++axis) {
            float sum = 0;
            for (int f = 0; f < features; ++f) sum += total[axis][f];
            to[axis] = sum;
        }
    }
}

// Adds the contribution of a batch to the gradients of planes [first, last). out[k] is the gradient of plane k, in the
// shape of the plane's values.
template <int Features>
FOURD_INLINE void scatter_run(const Plan& plan, std::size_t begin, int count, const RunPositions& positions, int first,
                              int last, const float* gradient, float* const* out) {
    const Query& query = *plan.query;
    const int features = Features > 0 ? Features : query.features;
    const std::size_t width = static_cast<std::size_t>(query.plane_count) * features;
    locate_run(plan, begin, count, positions);
    const auto values = [&](int k) FOURD_INLINE_LAMBDA { return out[k]; };
    for (int i = 0; i < count; ++i) {
        if (i + kPrefetchDistance < count) {
            prefetch_samples(plan, positions, i + kPrefetchDistance, first, last, values);
            const float* ahead = gradient + width * plan.order[begin + i + kPrefetchDistance];
            for (int f = first * features; f < last * features; f += 16) prefetch(ahead + f);
        }
        const float* from = gradient + width * plan.order[begin + i] + static_cast<std::size_t>(first) * features;
        for (int k = first; k < last; ++k, from += features) {
            const Corners c =
                corners(query.planes[k], positions.at(plan.x_axis[k], i), positions.at(plan.y_axis[k], i), features);
            scatter_sample<Features>(c, from, features, out[k] + c.top, out[k] + c.bottom);
        }
    }
}

template <int Features>
void sample(const Plan& plan, std::size_t begin, int count, const RunPositions& positions, float* out) {
    sample_run<Features>(plan, begin, count, positions, out);
}

template <int Features>
void coordinate_gradient(const Plan& plan, std::size_t begin, int count, const RunPositions& positions,
                         const float* gradient, float* out) {
    coordinate_gradient_run<Features>(plan, begin, count, positions, gradient, out);
}

template <int Features>
void scatter(const Plan& plan, std::size_t begin, int count, const RunPositions& positions, int first, int last,
             const float* gradient, float* const* out) {
    scatter_run<Features>(plan, begin, count, positions, first, last, gradient, out);
}

}  // namespace

const Loops loops = {{sample<8>, coordinate_gradient<8>, scatter<8>}, {sample<0>, coordinate_gradient<0>, scatter<0>}};

}  // namespace fourd::planes::FOURD_SIMD
