// Runs the kernels on small random and invalid inputs, in sanitizer builds. Three threads call the kernels at the same
// time. The sanitizers detect accesses out of bounds and data races. The program also checks that results are finite,
// even if some points are invalid.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "blend/blend.h"
#include "edge_gradients/edge_gradients.h"
#include "planes/planes.h"
#include "play/play.h"
#include "points/cpu/workspace.h"
#include "shade/shade.h"
#include "similarity/similarity.h"
#include "soft_triangles/cpu/workspace.h"
#include "splat_triangles/cpu/workspace.h"
#include "tests/antialias_inputs.h"
#include "tests/hashgrid_inputs.h"
#include "tests/image_inputs.h"
#include "tests/mesh_inputs.h"
#include "tests/random_inputs.h"
#include "tests/soft_inputs.h"
#include "tests/source_inputs.h"
#include "tests/splat_inputs.h"
#include "tests/texture_inputs.h"
#include "tests/training/encoder_inputs.h"
#include "tests/training/step_inputs.h"
#include "tests/unpack_inputs.h"

namespace {

using fourd::tests::expect_finite;
using fourd::tests::Floats;
using fourd::tests::Random;
using fourd::tests::random_floats;
using fourd::tests::random_int;
using fourd::tests::random_settings;

void run_points(unsigned seed, const char* simd) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 400));
    const std::size_t channels = static_cast<std::size_t>(random_int(random, 1, 32));
    const float hostile = seed % 2 ? 0.2f : 0.0f;
    const Floats xyz = random_floats(random, 3 * count, -1.5f, 1.5f, hostile);
    const Floats features = random_floats(random, channels * count, -1, 1, 0);
    const Floats radius = random_floats(random, count, 0, random_int(random, 0, 3) ? 0.2f : 5.0f, hostile);
    const Floats density = random_floats(random, count, 0, 1, hostile);
    fourd::points::Settings settings = random_settings(random, simd);
    const fourd::points::Cloud cloud{xyz.data(),     features.data(), radius.data(),
                                     density.data(), count,           static_cast<int>(channels)};
    const std::size_t pixels = static_cast<std::size_t>(settings.camera.width) * settings.camera.height;
    Floats image(pixels * channels), alpha(pixels), depth(pixels), seen(count);
    fourd::points::Workspace workspace;
    fourd::points::render(cloud, settings, workspace, {image.data(), alpha.data(), depth.data()});
    expect_finite(image, "features", seed);
    expect_finite(alpha, "alpha", seed);
    expect_finite(depth, "depth", seed);
    fourd::points::visibility(cloud, settings, workspace, seen.data());
    expect_finite(seen, "visibility", seed);
    const Floats up_image = random_floats(random, pixels * channels, -1, 1, 0);
    const Floats up_plane = random_floats(random, pixels, -1, 1, 0);
    Floats to_xyz(3 * count), to_features(channels * count), to_radius(count), to_density(count);
    const float* up_depth = seed % 3 ? up_plane.data() : nullptr;
    fourd::points::render_backward(cloud, settings, workspace, {up_image.data(), up_plane.data(), up_depth},
                                   {to_xyz.data(), to_features.data(), to_radius.data(), to_density.data()});
    expect_finite(to_xyz, "gradient of xyz", seed);
    expect_finite(to_radius, "gradient of radius", seed);
    expect_finite(to_features, "gradient of features", seed);
    expect_finite(to_density, "gradient of density", seed);
}

void run_planes(unsigned seed, const char* simd) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 700));
    const int features = random_int(random, 0, 2) ? 8 : random_int(random, 1, 64);
    const Floats coordinates = random_floats(random, 4 * count, -1.2f, 1.2f, seed % 2 ? 0.2f : 0.0f);
    std::vector<Floats> values, gradients;
    std::vector<fourd::planes::Plane> planes;
    std::vector<float*> targets;
    for (int k = random_int(random, 1, 7); k > 0; --k) {
        const int columns = random_int(random, 2, 40), rows = random_int(random, 2, 40);
        const std::size_t size = static_cast<std::size_t>(columns) * rows * features;
        values.push_back(random_floats(random, size, -1, 1, 0));
        gradients.emplace_back(size);
        planes.push_back({nullptr, columns, rows, random_int(random, 0, 3), random_int(random, 0, 3)});
    }
    for (std::size_t k = 0; k < planes.size(); ++k) {
        planes[k].values = values[k].data();
        targets.push_back(gradients[k].data());
    }
    const fourd::planes::Query query{planes.data(),
                                     static_cast<int>(planes.size()),
                                     features,
                                     coordinates.data(),
                                     count,
                                     random_int(random, 1, 4),
                                     fourd::simd_named(simd)};
    Floats out(count * planes.size() * features), to_coordinates(4 * count);
    fourd::planes::sample(query, out.data());
    expect_finite(out, "samples", seed);
    fourd::planes::sample_backward(query, out.data(), targets.data(),
                                   random_int(random, 0, 2) ? to_coordinates.data() : nullptr);
    for (const Floats& gradient : gradients) expect_finite(gradient, "gradient of planes", seed);
    expect_finite(to_coordinates, "gradient of coordinates", seed);
}

void run_hashgrid(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::HashGridInputs inputs(random, random_int(random, 0, 700), seed % 2 ? 0.2f : 0.0f);
    inputs.query.simd = fourd::simd_named(simd);
    fourd::hashgrid::encode(inputs.query, inputs.out.data());
    fourd::hashgrid::encode_backward(inputs.query, inputs.out.data(), inputs.grad_table(), inputs.grad_coordinates());
    inputs.expect_finite_results(seed);
}

void run_blend(unsigned seed, const char* simd) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 400)), views = random_int(random, 1, 5);
    const int hidden = random_int(random, 0, 2) ? 64 : random_int(random, 1, 256), channels = random_int(random, 1, 64);
    const std::size_t weights = static_cast<std::size_t>(hidden) * channels;
    const Floats weight = random_floats(random, weights, -1, 1, 0), out = random_floats(random, hidden, -1, 1, 0);
    const Floats point = random_floats(random, count * hidden, -3, 3, 0);
    const Floats samples = random_floats(random, views * channels * count, -1, 1, 0);
    const fourd::blend::Mlp mlp{weight.data(), out.data(), 0.1f, 5.0f, channels, hidden};
    const fourd::blend::Inputs inputs{point.data(), samples.data(),           count,
                                      views,        random_int(random, 1, 4), fourd::simd_named(simd)};
    Floats logits(views * count), to_point(point.size()), to_samples(samples.size()), to_weight(weights),
        to_out(hidden);
    float to_bias = 0;
    fourd::blend::logits(mlp, inputs, logits.data());
    expect_finite(logits, "logits", seed);
    fourd::blend::logits_backward(mlp, inputs, logits.data(), logits.data(),
                                  {to_point.data(), to_samples.data(), to_weight.data(), to_out.data(), &to_bias});
    expect_finite(to_point, "gradient of points", seed);
    expect_finite(to_samples, "gradient of samples", seed);
    expect_finite(to_weight, "gradient of weights", seed);
}

void run_play(unsigned seed, const char* simd) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 500));
    const std::size_t views = static_cast<std::size_t>(random_int(random, 1, 5));
    const Floats xyz = random_floats(random, 3 * count, -1.5f, 1.5f, seed % 2 ? 0.2f : 0.0f);
    std::vector<std::uint16_t> sh(48 * count, 0x3000), weights(views * count, 0x3c00), radius(count), density(count);
    std::vector<std::uint8_t> rgb(3 * views * count, 200);
    for (auto& half : radius) half = static_cast<std::uint16_t>(random_int(random, 0, 0x7bff));
    for (auto& half : density) half = static_cast<std::uint16_t>(random_int(random, 0, 0x3c00));
    const std::int32_t chosen[] = {0};
    const float view_weights[] = {0.5f};
    fourd::play::Player player;
    fourd::play::DepthSorter sorter;
    for (int picture = 0; picture < 2; ++picture) {
        const fourd::points::Settings settings = random_settings(random, simd);
        const fourd::shade::Settings shading{chosen,           view_weights, 1, {0, 0, -3}, 0.25f, 0.0f,
                                             settings.threads, settings.simd};
        std::vector<std::uint8_t> rgba(std::size_t{4} * settings.camera.width * settings.camera.height);
        const fourd::play::Frame frame{
            {xyz.data(), sh.data(), weights.data(), rgb.data(), count, views}, radius.data(), density.data()};
        player.draw(frame, settings, shading, {rgba.data(), {0, 0.5f, 1}}, seed % 3 ? 0.1f : 0.0f);
        fourd::tests::draw_surfaces(random, player, frame, settings, shading);
        std::vector<std::uint32_t> order(count);
        order.resize(sorter.sort(frame, settings, order.data()));
        std::sort(order.begin(), order.end());
        const bool valid = order.empty() || order.back() < count;
        if (!valid || std::adjacent_find(order.begin(), order.end()) != order.end()) {
            std::fprintf(stderr, "seed %u: the order contains a point twice, or an index out of range\n", seed);
            std::exit(1);
        }
    }
}

void run_shade(unsigned seed, const char* simd) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 700));
    const std::size_t views = static_cast<std::size_t>(random_int(random, 0, 9));
    const Floats xyz = random_floats(random, 3 * count, -1, 1, 0);
    std::vector<std::uint16_t> sh(48 * count), weights(views * count);
    std::vector<std::uint8_t> rgb(3 * views * count);
    for (auto& value : sh) value = static_cast<std::uint16_t>(random_int(random, 0, 0x7bff));
    for (auto& value : weights) value = static_cast<std::uint16_t>(random_int(random, 0, 0x6400));
    for (auto& value : rgb) value = static_cast<std::uint8_t>(random_int(random, 0, 255));
    std::vector<std::int32_t> chosen;
    for (std::size_t view = 0; view < views; view += 2) chosen.push_back(static_cast<std::int32_t>(view));
    const fourd::shade::Points points{xyz.data(), sh.data(), weights.data(), rgb.data(), count, views};
    const std::vector<float> view_weights(chosen.size(), 0.5f);
    const fourd::shade::Settings settings{
        chosen.data(), view_weights.data(),      static_cast<int>(chosen.size()), {0.5, 0.1, -3.0}, 0.25f,
        0.0f,          random_int(random, 1, 4), fourd::simd_named(simd)};
    Floats out(3 * count);
    fourd::shade::shade(points, settings, out.data());
    expect_finite(out, "colours", seed);
}

void run_similarity(unsigned seed, const char* simd) {
    Random random(seed);
    const int width = random_int(random, 11, 40), height = random_int(random, 11, 60),
              channels = random_int(random, 1, 4);
    const std::size_t size = static_cast<std::size_t>(width) * height * channels;
    const Floats picture = random_floats(random, size, 0, 1, 0), truth = random_floats(random, size, 0, 1, 0);
    Floats gradient(size);
    const double value = fourd::similarity::similarity(
        {picture.data(), truth.data(), width, height, channels, random_int(random, 1, 4), fourd::simd_named(simd)},
        seed % 4 ? gradient.data() : nullptr);
    expect_finite({static_cast<float>(value)}, "similarity", seed);
    expect_finite(gradient, "gradient of similarity", seed);
}

void run_sources(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::SourceInputs inputs(random, seed % 2 ? 0.2f : 0.0f);
    inputs.query.simd = fourd::simd_named(simd);
    fourd::sources::sample(inputs.query, inputs.out());
    fourd::sources::sample_backward(inputs.query, inputs.samples.data(), inputs.gradients());
    inputs.expect_finite_results(seed);
}

void run_antialias(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::AntialiasInputs inputs(random, 70, seed % 2 ? 0.1f : 0.0f);
    const fourd::antialias::Settings settings{random_int(random, 1, 4), fourd::simd_named(simd)};
    fourd::antialias::blend(inputs.mesh, inputs.images, settings, inputs.out.data(), inputs.codes.data());
    fourd::antialias::blend_backward(inputs.mesh, inputs.images, settings, inputs.gradients());
    inputs.expect_finite_results(seed);
    inputs.invent_codes(random);
    fourd::antialias::blend_backward(inputs.mesh, inputs.images, settings, inputs.gradients());
}

void run_edge_gradients(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::AntialiasInputs inputs(random, 70, seed % 2 ? 0.1f : 0.0f);
    const fourd::antialias::Settings settings{random_int(random, 1, 4), fourd::simd_named(simd)};
    fourd::edge_gradients::edge_gradients(inputs.mesh, inputs.images, settings, inputs.gradient.data(),
                                          inputs.to_positions.data());
    expect_finite(inputs.to_positions, "gradient of edges", seed);
}

void run_splat_triangles(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::SplatInputs inputs(random, 300, seed % 2 ? 0.1f : 0.0f, simd);
    fourd::splat_triangles::Workspace workspace;
    fourd::splat_triangles::render(inputs.mesh(), inputs.settings, workspace, inputs.picture(), inputs.weight.data());
    fourd::splat_triangles::render_backward(inputs.mesh(), inputs.settings, workspace, inputs.upstream(),
                                            inputs.gradient());
    inputs.expect_finite_results(seed);
}

void run_mesh(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::MeshInputs inputs(random, 90, seed % 2 ? 0.1f : 0.0f);
    inputs.query.simd = fourd::simd_named(simd);
    fourd::rasterize::rasterize(inputs.query, nullptr, inputs.rast.data(), inputs.rast_db.data());
    const Floats first = inputs.rast;
    if (seed % 3 == 0) {
        fourd::rasterize::rasterize(inputs.query, first.data(), inputs.rast.data(), inputs.rast_db.data());
    }
    fourd::rasterize::rasterize_backward(inputs.query, inputs.rast.data(), inputs.grad_rast.data(),
                                         seed % 4 ? inputs.grad_db.data() : nullptr, inputs.grad_pos.data());
    fourd::interpolate::interpolate(inputs.interpolation(), inputs.out.data(), inputs.out_da.data());
    fourd::interpolate::interpolate_backward(inputs.interpolation(), inputs.gradients());
    inputs.expect_finite_results(seed);
    inputs.invent_triangles(random);
    fourd::rasterize::rasterize_backward(inputs.query, inputs.rast.data(), inputs.grad_rast.data(),
                                         inputs.grad_db.data(), inputs.grad_pos.data());
    fourd::interpolate::interpolate_backward(inputs.interpolation(), inputs.gradients());
}

void run_soft_triangles(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::SoftInputs inputs(random, 100, seed % 2 ? 0.1f : 0.0f, simd);
    fourd::soft_triangles::Workspace workspace;
    fourd::soft_triangles::render(inputs.mesh(), inputs.settings, workspace, inputs.picture());
    fourd::soft_triangles::render_backward(inputs.mesh(), inputs.settings, workspace, inputs.upstream(),
                                           inputs.gradient());
    inputs.expect_finite_results(seed);
}

void run_rays(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::RayInputs inputs(random, 300, seed % 2 ? 0.1f : 0.0f, simd);
    fourd::rays::Tree tree = fourd::rays::build(inputs.mesh(), inputs.query.threads);
    for (int round = 0; round < 2; ++round) {
        fourd::rays::trace(inputs.view(tree), inputs.query, inputs.hits());
        fourd::rays::occluded(inputs.view(tree), inputs.query, inputs.flags.data());
        fourd::rays::trace_backward(inputs.mesh(), inputs.gradients());
        std::reverse(inputs.xyz.begin(), inputs.xyz.end());
        tree.magnitude = fourd::rays::refit(inputs.mesh(), tree.nodes.data(), tree.nodes.size(), tree.blocks.data(),
                                            tree.blocks.size(), inputs.query.threads);
    }
    expect_finite(inputs.u, "barycentric weights", seed);
    expect_finite(inputs.v, "barycentric weights", seed);
    inputs.invent_hits(random);
    fourd::rays::trace_backward(inputs.mesh(), inputs.gradients());
    const float hostile = seed % 2 ? 0.1f : 0.0f;
    expect_finite(inputs.composite_discs(random, hostile, fourd::rays::composite_discs), "picture of discs", seed);
}

void run_texture(unsigned seed, const char* simd) {
    Random random(seed);
    fourd::tests::TextureInputs inputs(random, 60, seed % 2 ? 0.1f : 0.0f);
    inputs.query.simd = fourd::simd_named(simd);
    if (inputs.is_chain) {
        const std::vector<float*> mips = inputs.mips();
        fourd::texture::build_mips(inputs.query.texture.shape, inputs.levels[0].data(), mips.data(),
                                   inputs.query.threads, inputs.query.simd);
    }
    fourd::texture::sample(inputs.query, inputs.out.data());
    fourd::texture::sample_backward(inputs.query, inputs.gradient.data(), inputs.is_chain,
                                    inputs.gradients(seed % 3 > 0));
    inputs.expect_finite_results(seed);
}

}  // namespace

int main(int count, char** arguments) {
    const unsigned runs = count > 1 ? static_cast<unsigned>(std::atoi(arguments[1])) : 200;
    for (const char* simd : {"baseline", "avx2", "avx512"}) {
        if (!fourd::simd_available(simd)) continue;
        fourd::tests::for_seeds(runs, [simd](unsigned seed) {
            run_points(seed, simd);
            run_planes(seed, simd);
            run_hashgrid(seed, simd);
            run_blend(seed, simd);
            fourd::tests::run_heads(seed, simd);
            fourd::tests::run_encoder(seed, simd);
            fourd::tests::run_step_images(seed, simd);
            fourd::tests::run_moves(seed);
            run_play(seed, simd);
            run_shade(seed, simd);
            run_similarity(seed, simd);
            run_sources(seed, simd);
            run_soft_triangles(seed, simd);
            run_splat_triangles(seed, simd);
            run_antialias(seed, simd);
            run_edge_gradients(seed, simd);
            run_mesh(seed, simd);
            run_rays(seed, simd);
            fourd::tests::run_unpack(seed, simd);
            fourd::tests::run_stylize(seed, simd);
            fourd::tests::run_pixel_filter(seed, simd);
            run_texture(seed, simd);
        });
        std::printf("all kernels, %s: %u inputs each\n", simd, runs);
    }
}
