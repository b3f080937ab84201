// Random and invalid inputs for soft rasterization, on the CPU and on an emulated GPU.
#pragma once

#include <cstdint>
#include <vector>

#include "soft_triangles/soft_triangles.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

struct SoftInputs {
    std::size_t vertices, count;
    int channels;
    Floats xyz, features;
    std::vector<std::int32_t> tri;
    soft_triangles::Settings settings;
    Floats image, alpha, up_image, up_alpha, to_xyz, to_features;

    SoftInputs(Random& random, int most, float hostile, const char* simd)
        : vertices(static_cast<std::size_t>(random_int(random, 3, 3 * most))),
          count(static_cast<std::size_t>(random_int(random, 0, most))),
          channels(random_int(random, 1, 32)) {
        xyz = random_floats(random, 3 * vertices, -1.5f, 1.5f, hostile);
        features = random_floats(random, count * channels, -1, 1, 0);
        for (std::size_t i = 0; i < 3 * count; ++i) {
            tri.push_back(random_int(random, 0, static_cast<int>(vertices) - 1));
        }
        const points::Settings same = random_settings(random, simd);
        const soft_triangles::Softness softness{
            random_int(random, 0, 1) == 1, 3.0f, 9.0f, 1.7f, random_int(random, 0, 1) ? 100.0f : 1.0f, 10.0f, 9.9f};
        settings = {same.camera, softness, same.near_depth, random_int(random, 0, 2) ? 1 << 20 : same.layers,
                    same.threads, same.simd};
        const std::size_t pixels = static_cast<std::size_t>(settings.camera.width) * settings.camera.height;
        image.resize(pixels * channels);
        alpha.resize(pixels);
        up_image = random_floats(random, image.size(), -1, 1, 0);
        up_alpha = random_floats(random, pixels, -1, 1, 0);
        to_xyz.resize(xyz.size());
        to_features.resize(features.size());
    }

    soft_triangles::Mesh mesh() const {
        return {xyz.data(), tri.data(), features.data(), vertices, count, channels};
    }
    soft_triangles::Image picture() { return {image.data(), alpha.data()}; }
    soft_triangles::ImageGradient upstream() const { return {up_image.data(), up_alpha.data()}; }
    soft_triangles::MeshGradient gradient() { return {to_xyz.data(), to_features.data()}; }

    void expect_finite_results(unsigned seed) const {
        expect_finite(image, "image of soft triangles", seed);
        expect_finite(alpha, "alpha of soft triangles", seed);
        expect_finite(to_xyz, "gradient of soft vertices", seed);
        expect_finite(to_features, "gradient of features of soft triangles", seed);
    }
};

}  // namespace fourd::tests
