#include "heads/cpu/lines.h"

#include <algorithm>

#include "planes/maths.h"

namespace fourd::heads {
namespace {

constexpr float kSamePosition = 1e-6f;  // Samples of two planes that are closer than this share a knot.
constexpr int kFirstWeights[3] = {kGeometryFirst, kBlendPoint, kShFirst};

// Calls visit(offset, weight) for the samples of a plane around a position and a time.
template <typename Visit>
void for_samples(const TimePlane& plane, float position, float time, int features, const Visit& visit) {
    const planes::Interpolation x = planes::interpolate_axis(position, plane.samples);
    const planes::Interpolation t = planes::interpolate_axis(time, plane.rows);
    for (int row = 0; row < 2; ++row) {
        const float share = row ? t.fraction : 1.0f - t.fraction;
        const std::size_t first = static_cast<std::size_t>(t.low + row) * plane.samples + x.low;
        visit(first * features, share * (1.0f - x.fraction));
        visit((first + 1) * features, share * x.fraction);
    }
}

}  // namespace

TimeTables::TimeTables(const Sizes& sizes, const TimePlanes& planes, const float* const* weights, const Loops& loops)
    : sizes_(sizes), planes_(planes), loops_(loops) {
    if (planes.count == 0) return;
    const int first = sizes.first_stride();
    axes_.resize(3);
    for (int k = 0; k < planes.count; ++k) axes_[planes.at[k].axis].planes.push_back(k);
    for (int index = 0; index < 3; ++index) {
        Axis& axis = axes_[index];
        axis.width = padded(static_cast<int>(axis.planes.size()) * planes.features);
        place_knots(axis);
        sample_planes(axis);
        pack_weights(axis, weights);
        const int knots = static_cast<int>(axis.positions.size());
        axis.values = Buffer<float>(static_cast<std::size_t>(knots) * first);
        loops.multiply({axis.features.data(), axis.weights.data(), knots, axis.width, first, axis.width, false},
                       axis.values.data());
        tables_[index] = {axis.values.data(), axis.positions.data(), axis.scales.data(), axis.starts.data(), knots,
                          knots_};
        knots_ += knots;
    }
}

void TimeTables::place_knots(Axis& axis) const {
    std::vector<float> all{-1.0f, 1.0f};
    for (const int k : axis.planes) {
        const int last = planes_.at[k].samples - 1;
        for (int i = 1; i < last; ++i) all.push_back(static_cast<float>(-1.0 + 2.0 * i / last));
    }
    std::sort(all.begin(), all.end());
    for (const float position : all) {
        if (axis.positions.empty() || position > axis.positions.back() + kSamePosition) {
            axis.positions.push_back(position);
        }
    }
    axis.positions.back() = 1.0f;
    const int knots = static_cast<int>(axis.positions.size());
    for (int i = 0; i + 1 < knots; ++i) axis.scales.push_back(1.0f / (axis.positions[i + 1] - axis.positions[i]));
    for (int bucket = 0, knot = 0; bucket < kBuckets; ++bucket) {
        const float start = -1.0f + 2.0f * static_cast<float>(bucket) / kBuckets;
        while (knot + 2 < knots && axis.positions[knot + 1] <= start) ++knot;
        axis.starts.push_back(knot);
    }
}

void TimeTables::sample_planes(Axis& axis) const {
    axis.features = Buffer<float>(axis.positions.size() * axis.width);
    std::fill_n(axis.features.data(), axis.features.size(), 0.0f);
    float* to = axis.features.data();
    for (const float position : axis.positions) {
        for (std::size_t j = 0; j < axis.planes.size(); ++j) {
            const TimePlane& plane = planes_.at[axis.planes[j]];
            float* features = to + j * planes_.features;
            for_samples(plane, position, planes_.time, planes_.features, [&](std::size_t offset, float weight) {
                for (int f = 0; f < planes_.features; ++f) features[f] += weight * plane.values[offset + f];
            });
        }
        to += axis.width;
    }
}

void TimeTables::pack_weights(Axis& axis, const float* const* weights) const {
    const std::size_t first = sizes_.first_stride(), h = sizes_.hidden_stride();
    axis.weights = Buffer<float>(axis.width * first);
    std::fill_n(axis.weights.data(), axis.weights.size(), 0.0f);
    for (std::size_t j = 0; j < axis.planes.size(); ++j) {
        for (int part = 0; part < 3; ++part) {
            const float* from = weights[kFirstWeights[part]] + planes_.at[axis.planes[j]].column;
            float* to = axis.weights.data() + j * planes_.features * first + part * h;
            for (int r = 0; r < sizes_.hidden; ++r) {
                for (int f = 0; f < planes_.features; ++f) to[f * first + r] = from[r * sizes_.inputs + f];
            }
        }
    }
}

void TimeTables::write_gradients(const float* to_tables, float* const* to_planes, float* const* to_weights) const {
    for (int k = 0; k < planes_.count; ++k) {
        const TimePlane& plane = planes_.at[k];
        std::fill_n(to_planes[k], static_cast<std::size_t>(plane.rows) * plane.samples * planes_.features, 0.0f);
    }
    for (std::size_t index = 0; index < axes_.size(); ++index) {
        const float* from = to_tables + tables_[index].first * sizes_.first_stride();
        write_weights(axes_[index], from, to_weights);
        add_to_planes(axes_[index], from, to_planes);
    }
}

void TimeTables::write_weights(const Axis& axis, const float* to_tables, float* const* out) const {
    const int first = sizes_.first_stride(), h = sizes_.hidden_stride();
    const int knots = static_cast<int>(axis.positions.size());
    Buffer<float> gradient(static_cast<std::size_t>(axis.width) * first);
    loops_.multiply({axis.features.data(), to_tables, axis.width, knots, first, axis.width, true}, gradient.data());
    for (std::size_t j = 0; j < axis.planes.size(); ++j) {
        for (int part = 0; part < 3; ++part) {
            const float* from = gradient.data() + j * planes_.features * first + part * h;
            float* to = out[kFirstWeights[part]] + planes_.at[axis.planes[j]].column;
            for (int r = 0; r < sizes_.hidden; ++r) {
                for (int f = 0; f < planes_.features; ++f) to[r * sizes_.inputs + f] = from[f * first + r];
            }
        }
    }
}

void TimeTables::add_to_planes(const Axis& axis, const float* to_tables, float* const* out) const {
    const int first = sizes_.first_stride(), knots = static_cast<int>(axis.positions.size());
    Buffer<float> rows(static_cast<std::size_t>(first) * axis.width);
    for (int k = 0; k < axis.width; ++k) {
        const float* from = axis.weights.data() + static_cast<std::size_t>(k) * first;
        for (int r = 0; r < first; ++r) rows[static_cast<std::size_t>(r) * axis.width + k] = from[r];
    }
    Buffer<float> gradient(static_cast<std::size_t>(knots) * axis.width);
    loops_.multiply({to_tables, rows.data(), knots, first, axis.width, first, false}, gradient.data());
    for (int i = 0; i < knots; ++i) {
        for (std::size_t j = 0; j < axis.planes.size(); ++j) {
            const int k = axis.planes[j];
            const float* from = gradient.data() + static_cast<std::size_t>(i) * axis.width + j * planes_.features;
            const auto add = [&](std::size_t offset, float weight) {
                for (int f = 0; f < planes_.features; ++f) out[k][offset + f] += weight * from[f];
            };
            for_samples(planes_.at[k], axis.positions[i], planes_.time, planes_.features, add);
        }
    }
}

}  // namespace fourd::heads
