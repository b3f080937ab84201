// Random inputs of the networks of the point model, of the image encoder, and of the updates at the end of a training step.
#pragma once

#include <cstdint>
#include <vector>

#include "encoder/encoder.h"
#include "heads/heads.h"
#include "moves/moves.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

inline void run_heads(unsigned seed, const char* simd) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 200));
    const heads::Sizes sizes{random_int(random, 1, 40), random_int(random, 1, 40), random_int(random, 3, 12),
                             random_int(random, 1, 5)};
    const float hostile = seed % 2 ? 0.2f : 0.0f;
    const std::size_t views = sizes.views;
    std::vector<Floats> weights, gradients;
    std::vector<const float*> pointers;
    heads::Gradients out{};
    for (int i = 0; i < heads::kWeightCount; ++i) {
        const heads::Shape shape = heads::weight_shape(sizes, i);
        weights.push_back(random_floats(random, static_cast<std::size_t>(shape.rows) * shape.columns, -1, 1, 0));
        gradients.push_back(weights.back());
    }
    for (int i = 0; i < heads::kWeightCount; ++i) {
        pointers.push_back(weights[i].data());
        out.weights[i] = gradients[i].data();
    }
    const Floats features = random_floats(random, count * sizes.features, -1, 1, hostile);
    const Floats samples = random_floats(random, views * sizes.channels * count, 0, 1, hostile);
    const Floats visibility = random_floats(random, views * count, 0, 1, hostile);
    const Floats shares = random_floats(random, views, 0, 1, 0), own = random_floats(random, 3 * count, 0, 1, hostile);
    const Floats xyz = random_floats(random, 3 * count, -1, 1, hostile);
    const Floats spacing = random_floats(random, count, 0, 1, hostile);
    const heads::Inputs inputs{features.data(), samples.data(), visibility.data(), shares.data(),
                               seed % 3 ? own.data() : nullptr, xyz.data(), spacing.data(), count};
    const heads::Settings settings{0.5f, 6, -1, 5, 5, 0.25f, seed % 2 ? 0.6f : 0.0f, 1e-3f, {0, 0, -3}};
    const heads::Execution execution{random_int(random, 1, 4), simd_named(simd)};
    Floats radius(count), density(count), sh(count * heads::kSh), colour(3 * count);
    Floats hidden(count * sizes.first_stride());
    heads::forward(sizes, settings, pointers.data(), inputs, execution,
                   {radius.data(), density.data(), sh.data(), colour.data(), hidden.data()});
    Floats to_features(features.size()), to_samples(samples.size()), to_own(own.size()), to_xyz(xyz.size());
    out.features = to_features.data(), out.samples = to_samples.data(), out.xyz = to_xyz.data();
    out.own = inputs.own ? to_own.data() : nullptr;
    const heads::Upstream upstream{radius.data(), density.data(), seed % 2 ? sh.data() : nullptr, colour.data(),
                                   hidden.data()};
    heads::backward(sizes, settings, pointers.data(), inputs, execution, upstream, out);
    if (hostile > 0) return;
    expect_finite(colour, "colours of heads", seed);
    for (const Floats& gradient : gradients) expect_finite(gradient, "gradients of weights", seed);
}

inline void run_encoder(unsigned seed, const char* simd) {
    Random random(seed);
    const int stride = random_int(random, 1, 2);
    const encoder::Sizes sizes{random_int(random, 0, 3), 4 * stride * random_int(random, 1, 6),
                               4 * stride * random_int(random, 1, 6), stride, random_int(random, 1, 20)};
    const float hostile = seed % 2 ? 0.2f : 0.0f;
    std::vector<Floats> weights, gradients;
    std::vector<const float*> pointers;
    std::vector<float*> out;
    for (int i = 0; i < encoder::kWeightCount; ++i) {
        weights.push_back(random_floats(random, encoder::weight_shape(sizes, i).size(), -1, 1, 0));
        gradients.push_back(weights.back());
    }
    for (int i = 0; i < encoder::kWeightCount; ++i) {
        pointers.push_back(weights[i].data());
        out.push_back(gradients[i].data());
    }
    const std::size_t pixels = static_cast<std::size_t>(sizes.images) * sizes.height * sizes.width;
    const Floats images = random_floats(random, 3 * pixels, 0, 1, hostile);
    Floats features(pixels / stride / stride * sizes.features), saved(sizes.images * encoder::saved_size(sizes));
    const encoder::Execution execution{random_int(random, 1, 4), simd_named(simd)};
    encoder::forward(sizes, pointers.data(), images.data(), execution, features.data(), nullptr);
    encoder::forward(sizes, pointers.data(), images.data(), execution, features.data(), saved.data());
    encoder::backward(sizes, pointers.data(), saved.data(), features.data(), execution, out.data());
    if (hostile > 0) return;
    expect_finite(features, "features of images", seed);
    for (const Floats& gradient : gradients) expect_finite(gradient, "gradients of the encoder's weights", seed);
}

inline void run_moves(unsigned seed) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 1, 3000));
    std::vector<std::int64_t> indices;
    for (std::size_t i = 0; i < count; ++i) {
        if (random_int(random, 0, 2)) indices.push_back(static_cast<std::int64_t>(i));
    }
    const moves::Rows rows{indices.data(), indices.size(), random_int(random, 1, 4)};
    Floats xyz = random_floats(random, 3 * count, -1, 1, 0.1f), first(3 * count), second(3 * count);
    Floats steps(count), sum(count), seen(count);
    const Floats before = random_floats(random, 3 * indices.size(), -1, 1, 0.1f);
    const Floats gradient = random_floats(random, 3 * indices.size(), -1, 1, 0.2f);
    const Floats planes = random_floats(random, 4 * count, -1, 1, 0.1f);
    const Floats spacing = random_floats(random, count, 0, 1, 0.1f);
    const Floats rates = random_floats(random, indices.size(), 0, 1, 0), matte = random_floats(random, 7 * 5, 0, 1, 0);
    moves::adam_rows(rows, steps.data(),
                     {{xyz.data(), first.data(), second.data(), gradient.data(), rates.data(), false, 3, 1e-15f}},
                     {0.9f, 0.99f});
    moves::smooth(rows, xyz.data(), {planes.data(), spacing.data(), rates.data(), 0.5f, 0.25f, 0.5f});
    const sources::Pinhole camera{{5, 0, 3, 0, 5, 2, 0, 0, 1}, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 1}};
    moves::keep_in_silhouettes(rows, xyz.data(), before.data(), {{camera, matte.data(), 7, 5}});
    const float axis[3] = {0, 0, 1}, centre[3] = {0, 0, -1};
    moves::keep_beyond(rows, xyz.data(), before.data(), axis, centre, 0.1f);
    moves::add_magnitudes(rows, gradient.data(), spacing.data(), sum.data(), seen.data());
    moves::adam({{xyz.data(), first.data(), second.data(), first.data(), 3 * count, 0.1f, 1.0f}}, {0.9f, 0.99f}, 1e-15f,
                rows.threads);
}

}  // namespace fourd::tests
