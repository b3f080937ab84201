// Runs the emulated CUDA kernels on small random and invalid inputs, in sanitizer builds. The sanitizers detect
// accesses out of bounds, and the emulator detects diverging lanes. The program also checks that results are finite,
// even if some points are invalid or the workspace has space for only a few entries.
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "antialias/cuda/antialias.h"
#include "edge_gradients/cuda/edge_gradients.h"
#include "encoder/cuda/encoder.h"
#include "hashgrid/cuda/encode.h"
#include "interpolate/cuda/interpolate.h"
#include "pixel_filter/cuda/pixel_filter.h"
#include "planes/cuda/sample.h"
#include "play/cuda/draw.h"
#include "points/cuda/render.h"
#include "rasterize/cuda/rasterize.h"
#include "rays/cuda/discs.h"
#include "rays/cuda/trace.h"
#include "soft_triangles/cuda/render.h"
#include "sources/cuda/sample.h"
#include "splat_triangles/cuda/render.h"
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
#include "texture/cuda/sample.h"

namespace {

using fourd::tests::expect_finite;
using fourd::tests::Floats;
using fourd::tests::Random;
using fourd::tests::random_floats;
using fourd::tests::random_int;
using fourd::tests::random_settings;

// Scratch memory of exactly `bytes` bytes, with space for `entries` (primitive, tile) entries.
class Memory {
  public:
    Memory(std::size_t bytes, std::size_t entries) : bytes_(bytes), buffer_{bytes_.data(), entries, &needed_} {}
    const fourd::points::cuda::EntryBuffer& buffer() const { return buffer_; }

  private:
    std::vector<unsigned char> bytes_;
    std::uint64_t needed_ = 0;
    fourd::points::cuda::EntryBuffer buffer_;
};

void run_points(unsigned seed) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 150));
    const std::size_t channels = static_cast<std::size_t>(random_int(random, 1, 32));
    const float hostile = seed % 2 ? 0.2f : 0.0f;
    const Floats xyz = random_floats(random, 3 * count, -1.5f, 1.5f, hostile);
    const Floats features = random_floats(random, channels * count, -1, 1, 0);
    const Floats radius = random_floats(random, count, 0, random_int(random, 0, 3) ? 0.2f : 5.0f, hostile);
    const Floats density = random_floats(random, count, 0, 1, hostile);
    const fourd::points::Settings settings = random_settings(random, "");
    const fourd::points::Cloud cloud{xyz.data(),     features.data(), radius.data(),
                                     density.data(), count,           static_cast<int>(channels)};
    const int width = settings.camera.width, height = settings.camera.height;
    const std::size_t pixels = static_cast<std::size_t>(width) * height;
    const std::size_t entries = static_cast<std::size_t>(random_int(random, 0, 2) ? 4000 : random_int(random, 0, 20));
    const Memory memory(fourd::points::cuda::workspace_bytes(count, cloud.channels, width, height, entries), entries);
    Floats image(pixels * channels), alpha(pixels), depth(pixels), seen(count);
    fourd::points::cuda::render(cloud, settings, memory.buffer(), {image.data(), alpha.data(), depth.data()}, nullptr);
    expect_finite(image, "features", seed);
    expect_finite(alpha, "alpha", seed);
    expect_finite(depth, "depth", seed);
    fourd::points::cuda::visibility(cloud, settings, memory.buffer(), seen.data(), nullptr);
    expect_finite(seen, "visibility", seed);
    const Floats up_image = random_floats(random, pixels * channels, -1, 1, 0);
    const Floats up_plane = random_floats(random, pixels, -1, 1, 0);
    Floats to_xyz(3 * count), to_features(channels * count), to_radius(count), to_density(count);
    const float* up_depth = seed % 3 ? up_plane.data() : nullptr;
    fourd::points::cuda::render_backward(cloud, settings, memory.buffer(), {up_image.data(), up_plane.data(), up_depth},
                                         {to_xyz.data(), to_features.data(), to_radius.data(), to_density.data()},
                                         nullptr);
    expect_finite(to_xyz, "gradient of xyz", seed);
    expect_finite(to_radius, "gradient of radius", seed);
    expect_finite(to_features, "gradient of features", seed);
    expect_finite(to_density, "gradient of density", seed);
}

void run_play(unsigned seed) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 150));
    const std::size_t views = static_cast<std::size_t>(random_int(random, 1, 5));
    const Floats xyz = random_floats(random, 3 * count, -1.5f, 1.5f, seed % 2 ? 0.2f : 0.0f);
    std::vector<std::uint16_t> sh(48 * count, 0x3000), weights(views * count, 0x3c00), radius(count), density(count);
    std::vector<std::uint8_t> rgb(3 * views * count, 200);
    for (auto& half : radius) half = static_cast<std::uint16_t>(random_int(random, 0, 0x7bff));
    for (auto& half : density) half = static_cast<std::uint16_t>(random_int(random, 0, 0x3c00));
    const std::int32_t chosen[] = {0};
    const float view_weights[] = {0.5f};
    const fourd::points::Settings settings = random_settings(random, "");
    const int width = settings.camera.width, height = settings.camera.height;
    const fourd::shade::Settings shading{chosen, view_weights, 1, {0, 0, -3}, 0.25f, 0.0f, 1, settings.simd};
    std::vector<std::uint8_t> rgba(std::size_t{4} * width * height);
    const fourd::play::Frame frame{
        {xyz.data(), sh.data(), weights.data(), rgb.data(), count, views}, radius.data(), density.data()};
    const Memory memory(fourd::play::cuda::workspace_bytes(count, width, height, 1000), 1000);
    fourd::play::cuda::draw(frame, settings, shading, memory.buffer(), {rgba.data(), {0, 0.5f, 1}}, nullptr);
}

void run_planes(unsigned seed) {
    Random random(seed);
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 200));
    const int features = random_int(random, 0, 2) ? 8 : random_int(random, 1, 64);
    const int columns = random_int(random, 2, 40), rows = random_int(random, 2, 40);
    const Floats coordinates = random_floats(random, 4 * count, -1.2f, 1.2f, seed % 2 ? 0.2f : 0.0f);
    const Floats values = random_floats(random, static_cast<std::size_t>(columns) * rows * features, -1, 1, 0);
    const fourd::planes::Plane plane{values.data(), columns, rows, random_int(random, 0, 3), random_int(random, 0, 3)};
    const fourd::planes::Query query{&plane, 1, features, coordinates.data(), count, 1, fourd::Simd::baseline};
    Floats out(count * features), to_values(values.size()), to_coordinates(4 * count);
    float* const target = to_values.data();
    fourd::planes::cuda::sample(query, out.data(), nullptr);
    expect_finite(out, "samples", seed);
    fourd::planes::cuda::sample_backward(query, out.data(), &target, to_coordinates.data(), nullptr);
    expect_finite(to_values, "gradient of planes", seed);
    expect_finite(to_coordinates, "gradient of coordinates", seed);
}

void run_hashgrid(unsigned seed) {
    Random random(seed);
    fourd::tests::HashGridInputs inputs(random, random_int(random, 0, 200), seed % 2 ? 0.2f : 0.0f);
    fourd::hashgrid::cuda::encode(inputs.query, inputs.out.data(), nullptr);
    fourd::hashgrid::cuda::encode_backward(inputs.query, inputs.out.data(), inputs.grad_table(),
                                           inputs.grad_coordinates(), nullptr);
    inputs.expect_finite_results(seed);
}

void run_sources(unsigned seed) {
    Random random(seed);
    fourd::tests::SourceInputs inputs(random, seed % 2 ? 0.2f : 0.0f);
    fourd::sources::cuda::sample(inputs.query, inputs.out(), nullptr);
    fourd::sources::cuda::sample_backward(inputs.query, inputs.samples.data(), inputs.gradients(), nullptr);
    inputs.expect_finite_results(seed);
}

void run_antialias(unsigned seed) {
    Random random(seed);
    fourd::tests::AntialiasInputs inputs(random, 30, seed % 2 ? 0.1f : 0.0f);
    std::vector<unsigned char> workspace(
        fourd::antialias::cuda::workspace_bytes(inputs.mesh, inputs.images.count));
    fourd::antialias::cuda::blend(inputs.mesh, inputs.images, workspace.data(), inputs.out.data(), inputs.codes.data(),
                                  nullptr);
    fourd::antialias::cuda::blend_backward(inputs.mesh, inputs.images, inputs.gradients(), nullptr);
    inputs.expect_finite_results(seed);
    inputs.invent_codes(random);
    fourd::antialias::cuda::blend_backward(inputs.mesh, inputs.images, inputs.gradients(), nullptr);
}

void run_edge_gradients(unsigned seed) {
    Random random(seed);
    fourd::tests::AntialiasInputs inputs(random, 30, seed % 2 ? 0.1f : 0.0f);
    std::vector<unsigned char> workspace(
        fourd::edge_gradients::cuda::workspace_bytes(inputs.mesh, inputs.images.count));
    fourd::edge_gradients::cuda::edge_gradients(inputs.mesh, inputs.images, workspace.data(), inputs.gradient.data(),
                                                inputs.to_positions.data(), nullptr);
    expect_finite(inputs.to_positions, "gradient of edges", seed);
}

void run_splat_triangles(unsigned seed) {
    Random random(seed);
    fourd::tests::SplatInputs inputs(random, 100, seed % 2 ? 0.1f : 0.0f, "");
    const fourd::splat_triangles::Mesh mesh = inputs.mesh();
    const std::size_t entries = static_cast<std::size_t>(random_int(random, 0, 2) ? 4000 : random_int(random, 0, 20));
    const Memory memory(
        fourd::splat_triangles::cuda::workspace_bytes(mesh.count, mesh.channels, inputs.settings.camera.width,
                                                      inputs.settings.camera.height, entries),
        entries);
    fourd::splat_triangles::cuda::render(mesh, inputs.settings, memory.buffer(), inputs.picture(), inputs.weight.data(),
                                         nullptr);
    fourd::splat_triangles::cuda::render_backward(mesh, inputs.settings, memory.buffer(), inputs.upstream(),
                                                  inputs.gradient(), nullptr);
    inputs.expect_finite_results(seed);
}

void run_mesh(unsigned seed) {
    Random random(seed);
    fourd::tests::MeshInputs inputs(random, 50, seed % 2 ? 0.1f : 0.0f);
    const fourd::rasterize::Query& query = inputs.query;
    const std::size_t images = static_cast<std::size_t>(query.images);
    std::vector<unsigned char> workspace(
        fourd::rasterize::cuda::workspace_bytes(images, query.height, query.width, query.triangles));
    Floats first;
    for (unsigned layer = 0; layer <= seed % 2; ++layer) {
        fourd::rasterize::cuda::rasterize(query, query.triangles, workspace.data(), layer > 0 ? first.data() : nullptr,
                                          inputs.rast.data(), inputs.rast_db.data(), nullptr);
        first = inputs.rast;
    }
    fourd::rasterize::cuda::rasterize_backward(query, inputs.rast.data(), inputs.grad_rast.data(),
                                               seed % 4 ? inputs.grad_db.data() : nullptr, inputs.grad_pos.data(),
                                               nullptr);
    fourd::interpolate::cuda::interpolate(inputs.interpolation(), inputs.out.data(), inputs.out_da.data(), nullptr);
    fourd::interpolate::cuda::interpolate_backward(inputs.interpolation(), inputs.gradients(), nullptr);
    inputs.expect_finite_results(seed);
    inputs.invent_triangles(random);
    fourd::rasterize::cuda::rasterize_backward(query, inputs.rast.data(), inputs.grad_rast.data(),
                                               inputs.grad_db.data(), inputs.grad_pos.data(), nullptr);
    fourd::interpolate::cuda::interpolate_backward(inputs.interpolation(), inputs.gradients(), nullptr);
}

void run_soft_triangles(unsigned seed) {
    Random random(seed);
    fourd::tests::SoftInputs inputs(random, 30, seed % 2 ? 0.1f : 0.0f, "");
    const fourd::soft_triangles::Mesh mesh = inputs.mesh();
    const int width = inputs.settings.camera.width, height = inputs.settings.camera.height;
    const std::size_t entries = static_cast<std::size_t>(random_int(random, 0, 2) ? 4000 : random_int(random, 0, 20));
    const Memory memory(
        fourd::soft_triangles::cuda::workspace_bytes(mesh.count, mesh.channels, width, height, entries), entries);
    fourd::soft_triangles::cuda::render(mesh, inputs.settings, memory.buffer(), inputs.picture(), nullptr);
    fourd::soft_triangles::cuda::render_backward(mesh, inputs.settings, memory.buffer(), inputs.upstream(),
                                                 inputs.gradient(), nullptr);
    inputs.expect_finite_results(seed);
}

void run_rays(unsigned seed) {
    Random random(seed);
    const float hostile = seed % 2 ? 0.1f : 0.0f;
    fourd::tests::RayInputs inputs(random, 100, hostile, "");
    const fourd::rays::Tree tree = fourd::rays::build(inputs.mesh(), 1);
    fourd::rays::cuda::trace(inputs.view(tree), inputs.query, inputs.hits(), nullptr);
    fourd::rays::cuda::occluded(inputs.view(tree), inputs.query, inputs.flags.data(), nullptr);
    fourd::rays::cuda::trace_backward(inputs.mesh(), inputs.gradients(), nullptr);
    expect_finite(inputs.u, "barycentric weights", seed);
    inputs.invent_hits(random);
    fourd::rays::cuda::trace_backward(inputs.mesh(), inputs.gradients(), nullptr);
    const auto composite = [](const auto&... arguments) { fourd::rays::cuda::composite_discs(arguments..., nullptr); };
    expect_finite(inputs.composite_discs(random, hostile, composite), "picture of discs", seed);
}

void run_texture(unsigned seed) {
    Random random(seed);
    fourd::tests::TextureInputs inputs(random, 25, seed % 2 ? 0.1f : 0.0f);
    if (inputs.is_chain) {
        const std::vector<float*> mips = inputs.mips();
        fourd::texture::cuda::build_mips(inputs.query.texture.shape, inputs.levels[0].data(), mips.data(), nullptr);
    }
    fourd::texture::cuda::sample(inputs.query, inputs.out.data(), nullptr);
    fourd::texture::cuda::sample_backward(inputs.query, inputs.gradient.data(), inputs.is_chain,
                                          inputs.gradients(seed % 3 > 0), nullptr);
    inputs.expect_finite_results(seed);
}

void run_pixel_filter(unsigned seed) {
    Random random(seed);
    fourd::tests::FilterInput input(random);
    fourd::pixel_filter::cuda::filter_pixels(input.image(), input.side, input.out.data(), nullptr);
}

void run_encoder(unsigned seed) {
    fourd::tests::EncoderInputs inputs(seed);
    namespace cuda = fourd::encoder::cuda;
    Floats saved(cuda::saved_size(inputs.sizes)), workspace(cuda::workspace_size(inputs.sizes));
    cuda::forward(inputs.sizes, inputs.layers.data(), inputs.images.data(), inputs.features.data(), saved.data(),
                  nullptr);
    cuda::backward(inputs.sizes, inputs.layers.data(), saved.data(), inputs.features.data(), workspace.data(),
                   inputs.out.data(), nullptr);
    inputs.expect_finite_results(seed);
}

}  // namespace

int main(int count, char** arguments) {
    const unsigned runs = count > 1 ? static_cast<unsigned>(std::atoi(arguments[1])) : 100;
    fourd::tests::for_seeds(runs, [](unsigned seed) {
        run_points(seed);
        run_play(seed);
        run_planes(seed);
        run_hashgrid(seed);
        run_sources(seed);
        run_soft_triangles(seed);
        run_splat_triangles(seed);
        run_antialias(seed);
        run_edge_gradients(seed);
        run_mesh(seed);
        run_rays(seed);
        run_texture(seed);
        run_pixel_filter(seed);
        run_encoder(seed);
    });
    std::printf("all kernels, emulated GPU: %u inputs each\n", runs);
}
