// Random inputs of the networks of the point model, of the images of a training step, and of the updates at its end.
#pragma once

#include <cstdint>
#include <vector>

#include "heads/heads.h"
#include "moves/moves.h"
#include "step_images/step_images.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

inline void run_heads(unsigned seed, const char* simd) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 200));
    const int plane_count = seed % 4 < 2 ? 0 : random_int(random, 1, 4), plane_features = random_int(random, 1, 9);
    heads::Sizes sizes{random_int(random, 1, 40), random_int(random, 1, 40), random_int(random, 3, 12),
                       random_int(random, 1, 5), 0};
    sizes.inputs = sizes.features + plane_count * plane_features;
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
    std::vector<Floats> values, to_values;
    std::vector<heads::TimePlane> planes;
    std::vector<float*> to_planes;
    for (int k = 0; k < plane_count; ++k) {
        const int rows = random_int(random, 2, 9), plane_samples = random_int(random, 2, 30);
        const std::size_t size = static_cast<std::size_t>(rows) * plane_samples * plane_features;
        values.push_back(random_floats(random, size, -1, 1, hostile));
        to_values.push_back(values.back());
        const int column = sizes.inputs - (k + 1) * plane_features;
        planes.push_back({values.back().data(), rows, plane_samples, random_int(random, 0, 2), column});
        to_planes.push_back(to_values.back().data());
    }
    const Floats coordinates = random_floats(random, 4 * count, -1.2f, 1.2f, hostile);
    const Floats features = random_floats(random, count * sizes.features, -1, 1, hostile);
    const Floats samples = random_floats(random, views * sizes.channels * count, 0, 1, hostile);
    const Floats visibility = random_floats(random, views * count, 0, 1, hostile);
    const Floats shares = random_floats(random, views, 0, 1, 0), own = random_floats(random, 3 * count, 0, 1, hostile);
    const Floats xyz = random_floats(random, 3 * count, -1, 1, hostile);
    const Floats spacing = random_floats(random, count, 0, 1, hostile);
    const heads::Inputs inputs{features.data(), samples.data(), visibility.data(), shares.data(),
                               seed % 3 ? own.data() : nullptr, xyz.data(), spacing.data(), count,
                               {planes.data(), plane_count, plane_features, coordinates.data(),
                                random_floats(random, 1, -1, 1, hostile)[0]}};
    const heads::Settings settings{0.5f, 6, -1, 5, 5, 0.25f, seed % 2 ? 0.6f : 0.0f, 1e-3f, {0, 0, -3}};
    const heads::Execution execution{random_int(random, 1, 4), simd_named(simd)};
    Floats radius(count), density(count), sh(count * heads::kSh), colour(3 * count);
    Floats saved(sizes.saved_size(count));
    heads::forward(sizes, settings, pointers.data(), inputs, execution,
                   {radius.data(), density.data(), sh.data(), colour.data(), saved.data()});
    Floats to_features(features.size()), to_samples(samples.size()), to_own(own.size()), to_xyz(xyz.size());
    out.features = to_features.data(), out.samples = to_samples.data(), out.xyz = to_xyz.data();
    out.own = inputs.own ? to_own.data() : nullptr;
    out.time_planes = to_planes.data();
    const heads::Upstream upstream{radius.data(), density.data(), seed % 2 ? sh.data() : nullptr, colour.data()};
    heads::backward(sizes, settings, pointers.data(), inputs, execution, {sh.data(), saved.data()}, upstream, out);
    if (hostile > 0) return;
    expect_finite(colour, "colours of heads", seed);
    for (const Floats& gradient : gradients) expect_finite(gradient, "gradients of weights", seed);
    for (const Floats& gradient : to_values) expect_finite(gradient, "gradients of time planes", seed);
}

inline void run_step_images(unsigned seed, const char* simd) {
    Random random(seed);
    const float hostile = seed % 2 ? 0.2f : 0.0f;
    const step_images::Grid grid{random_int(random, 1, 40), random_int(random, 1, 40), random_int(random, 1, 3)};
    const step_images::Execution execution{random_int(random, 1, 4), simd_named(simd)};
    const std::size_t pixels = static_cast<std::size_t>(grid.height) * grid.width;
    const std::size_t samples = pixels * grid.samples * grid.samples;
    std::vector<std::uint8_t> rgb(3 * pixels), matte(pixels);
    for (std::uint8_t& byte : rgb) byte = static_cast<std::uint8_t>(random_int(random, 0, 255));
    for (std::uint8_t& byte : matte) byte = static_cast<std::uint8_t>(random_int(random, 0, 255));
    const step_images::View view{rgb.data(), matte.data(), grid.height, grid.width};
    const int more = random_int(random, 0, 5);
    const std::size_t padded = static_cast<std::size_t>(grid.height + more) * (grid.width + more);
    Floats images(3 * padded), mattes(padded), colours(3 * pixels), weights(pixels), truth(3 * pixels);
    step_images::convert_views(&view, 1, grid.height + more, grid.width + more, execution, images.data(),
                               mattes.data());
    step_images::premultiply(view, execution, colours.data(), weights.data());
    const float background[3] = {0.1f, 0.5f, 1.0f};
    step_images::add_background(pixels, colours.data(), weights.data(), background, execution, truth.data());
    Floats features = random_floats(random, 4 * samples, 0, 1, hostile);
    Floats alpha = random_floats(random, samples, 0, 1, 0);
    Floats colour(3 * pixels), last(pixels), prediction(3 * pixels), gradient(3 * pixels);
    step_images::resolve(grid, {features.data(), alpha.data()}, background, execution,
                         {colour.data(), last.data(), prediction.data()});
    const step_images::Table table{pixels, 3, random_int(random, 0, 2)};
    step_images::mean_square(table, prediction.data(), seed % 3 ? truth.data() : nullptr, false, execution,
                             0.5f, gradient.data());
    step_images::resolve_backward(grid, {seed % 4 ? colour.data() : nullptr, last.data(), gradient.data()}, background,
                                  execution, features.data(), alpha.data());
    expect_finite(images, "converted views", seed);
    expect_finite(truth, "ground truth", seed);
    if (hostile == 0.0f) expect_finite(features, "gradients of samples", seed);
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
