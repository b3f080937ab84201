// Workloads of the kernels that only training steps use, with the sizes of the default model.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "encoder/encoder.h"
#include "heads/heads.h"
#include "moves/moves.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

// Arrays of random weights, and arrays of the same sizes for their gradients.
struct Layers {
    std::vector<Floats> weights, gradients;

    template <typename SizeOf>
    Layers(Random& random, int count, const SizeOf& size_of) {
        for (int i = 0; i < count; ++i) weights.push_back(random_floats(random, size_of(i), -0.2f, 0.2f, 0));
        gradients = weights;
    }

    std::vector<const float*> inputs() const {
        std::vector<const float*> out;
        for (const Floats& each : weights) out.push_back(each.data());
        return out;
    }
    std::vector<float*> outputs() {
        std::vector<float*> out;
        for (Floats& each : gradients) out.push_back(each.data());
        return out;
    }
};

// Points with random features and samples, time planes, and room for all results of the networks.
struct HeadsWork {
    heads::Sizes sizes{72, 64, 11, 4, 144};
    heads::Settings settings{0.5f, 6, -1, 5, 5, 0.25f, 0.6f, 1e-3f, {0, 0, -3}};
    heads::Execution execution;
    Random random{8};
    Layers layers;
    std::size_t count;
    std::vector<Floats> plane_values, plane_gradients;
    std::vector<heads::TimePlane> planes;
    std::vector<float*> to_planes;
    Floats coordinates, features, samples, visibility, shares, own, xyz, spacing;
    Floats radius, density, sh, colour, saved, to_features, to_samples, to_own, to_xyz;

    HeadsWork(std::size_t points, heads::Execution how)
        : execution(how),
          layers(random, heads::kWeightCount,
                 [this](int i) {
                     const heads::Shape shape = heads::weight_shape(sizes, i);
                     return static_cast<std::size_t>(shape.rows) * shape.columns;
                 }),
          count(points),
          coordinates(4 * count),
          features(random_floats(random, count * sizes.features, -1, 1, 0)),
          samples(random_floats(random, sizes.views * sizes.channels * count, 0, 1, 0)),
          visibility(random_floats(random, sizes.views * count, 0, 1, 0)),
          shares(random_floats(random, sizes.views, 0.1f, 1, 0)),
          own(random_floats(random, 3 * count, 0, 1, 0)),
          xyz(random_floats(random, 3 * count, -1, 1, 0)),
          spacing(count, 0.01f),
          radius(count),
          density(count),
          sh(count * heads::kSh),
          colour(3 * count),
          saved(sizes.saved_size(count)),
          to_features(features.size()),
          to_samples(samples.size()),
          to_own(own.size()),
          to_xyz(xyz.size()) {
        // Points in Morton order: successive points are close to each other.
        for (std::size_t i = 0; i < coordinates.size(); ++i) {
            const float before = i < 4 ? 0.0f : coordinates[i - 4], moved = before + uniform(random, -0.05f, 0.05f);
            coordinates[i] = moved > -1 && moved < 1 ? moved : before;
        }
        constexpr int kRows = 24, kFeatures = 8;
        for (int level = 0; level < 3; ++level) {
            for (int axis = 0; axis < 3; ++axis) {
                const int samples_per_row = 32 << level;
                plane_values.emplace_back(static_cast<std::size_t>(kRows) * samples_per_row * kFeatures, 0.1f);
                plane_gradients.push_back(plane_values.back());
                planes.push_back({plane_values.back().data(), kRows, samples_per_row, axis,
                                  level * 48 + 24 + axis * kFeatures});
                to_planes.push_back(plane_gradients.back().data());
            }
        }
    }

    heads::Inputs inputs() const {
        return {features.data(), samples.data(), visibility.data(), shares.data(),
                own.data(),      xyz.data(),     spacing.data(),    count,
                {planes.data(), static_cast<int>(planes.size()), 8, coordinates.data(), 0.3f}};
    }

    void forward() {
        heads::forward(sizes, settings, layers.inputs().data(), inputs(), execution,
                       {radius.data(), density.data(), sh.data(), colour.data(), saved.data()});
    }

    void backward() {
        heads::Gradients out{to_features.data(), to_samples.data(), to_own.data(), to_xyz.data(), {}, to_planes.data()};
        for (int i = 0; i < heads::kWeightCount; ++i) out.weights[i] = layers.gradients[i].data();
        const heads::Upstream upstream{radius.data(), density.data(), sh.data(), colour.data()};
        heads::backward(sizes, settings, layers.inputs().data(), inputs(), execution, {sh.data(), saved.data()},
                        upstream, out);
    }
};

inline std::function<void()> heads_workload(std::size_t points, int threads, Simd simd, bool backward) {
    const auto work = std::make_shared<HeadsWork>(points, heads::Execution{threads, simd});
    work->forward();
    if (backward) return [work] { work->backward(); };
    return [work] { work->forward(); };
}

// Four images. The forward pass of a step that does not train the encoder saves nothing.
inline std::function<void()> encoder_workload(int width, int height, int threads, Simd simd, bool backward) {
    const encoder::Sizes sizes{4, height, width, 2, 8};
    const encoder::Execution execution{threads, simd};
    Random random(9);
    Layers layers(random, encoder::kWeightCount, [&](int i) { return encoder::weight_shape(sizes, i).size(); });
    Floats images = random_floats(random, std::size_t{12} * height * width, 0, 1, 0);
    Floats features(static_cast<std::size_t>(sizes.images) * sizes.out_height() * sizes.out_width() * sizes.features);
    Floats saved(sizes.images * encoder::saved_size(sizes));
    encoder::forward(sizes, layers.inputs().data(), images.data(), execution, features.data(), saved.data());
    return [=]() mutable {
        const std::vector<const float*> weights = layers.inputs();
        if (backward) {
            encoder::backward(sizes, weights.data(), saved.data(), features.data(), execution,
                              layers.outputs().data());
        } else {
            encoder::forward(sizes, weights.data(), images.data(), execution, features.data(), nullptr);
        }
    };
}

// The updates at the end of a step: Adam of a network and of every second point, and smoothing.
inline std::function<void()> moves_workload(std::size_t points, int threads) {
    Random random(10);
    std::vector<std::int64_t> chosen;
    for (std::size_t i = 0; i < points; i += 2) chosen.push_back(static_cast<std::int64_t>(i));
    Floats xyz = random_floats(random, 3 * points, -1, 1, 0), planes = random_floats(random, 4 * points, -1, 1, 0);
    Floats gradient = random_floats(random, 3 * points, -1, 1, 0);
    return [=, first = Floats(3 * points), second = Floats(3 * points), steps = Floats(points),
            spacing = Floats(points, 0.01f), rates = Floats(points, 1e-3f)]() mutable {
        const moves::Rows rows{chosen.data(), chosen.size(), threads};
        moves::adam({{xyz.data(), first.data(), second.data(), gradient.data(), 3 * points, 1e-4f, 1.0f}},
                    {0.9f, 0.99f}, 1e-15f, threads);
        moves::adam_rows(
            rows, steps.data(),
            {{xyz.data(), first.data(), second.data(), gradient.data(), rates.data(), false, 3, 1e-15f}},
            {0.9f, 0.99f});
        moves::smooth(rows, xyz.data(), {planes.data(), spacing.data(), rates.data(), 0.5f, 0.25f, 0.5f});
    };
}

}  // namespace fourd::tests
