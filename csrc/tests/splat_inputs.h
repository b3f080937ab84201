// Random and invalid inputs for triangle splatting, on the CPU and on an emulated GPU.
#pragma once

#include <cstdint>
#include <vector>

#include "splat_triangles/splat_triangles.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

struct SplatInputs {
    std::size_t vertices, count;
    bool geometry;
    int features;
    Floats xyz, values, opacity, sigma;
    std::vector<std::int32_t> tri;
    splat_triangles::Settings settings;
    Floats image, alpha, transmittance, normal, depth, weight;
    Floats up_image, up_alpha, up_normal, up_depth;
    Floats to_xyz, to_values, to_opacity, to_sigma;

    SplatInputs(Random& random, int most, float hostile, const char* simd)
        : vertices(static_cast<std::size_t>(random_int(random, 3, 3 * most))),
          count(static_cast<std::size_t>(random_int(random, 0, most))),
          geometry(random_int(random, 0, 1) == 1),
          features(random_int(random, 0, 2) ? 3 : random_int(random, 1, 32)) {
        const std::size_t channels = static_cast<std::size_t>(features + (geometry ? splat_triangles::kGeometry : 0));
        xyz = random_floats(random, 3 * vertices, -1.5f, 1.5f, hostile);
        values = random_floats(random, channels * count, -1, 1, 0);
        opacity = random_floats(random, count, 0, 1, hostile);
        sigma = random_floats(random, count, 0, 3, hostile);
        for (std::size_t i = 0; i < 3 * count; ++i) {
            tri.push_back(random_int(random, 0, static_cast<int>(vertices) - 1));
        }
        const points::Settings same = random_settings(random, simd);
        settings = {same.camera, same.near_depth, random_int(random, 0, 2) ? 1 << 20 : same.layers, same.threads,
                    same.simd};
        const std::size_t pixels = static_cast<std::size_t>(settings.camera.width) * settings.camera.height;
        const std::size_t extra = geometry ? pixels : 0;
        for (Floats* plane : {&alpha, &transmittance}) plane->resize(pixels);
        image.resize(pixels * features);
        normal.resize(3 * extra);
        depth.resize(extra);
        weight.resize(count);
        up_image = random_floats(random, image.size(), -1, 1, 0);
        up_alpha = random_floats(random, pixels, -1, 1, 0);
        up_normal = random_floats(random, normal.size(), -1, 1, 0);
        up_depth = random_floats(random, extra, -1, 1, 0);
        to_xyz.resize(xyz.size());
        to_values.resize(values.size());
        to_opacity.resize(count);
        to_sigma.resize(count);
    }

    splat_triangles::Mesh mesh() const {
        return {xyz.data(),
                tri.data(),
                values.data(),
                opacity.data(),
                sigma.data(),
                vertices,
                count,
                features + (geometry ? splat_triangles::kGeometry : 0),
                geometry};
    }
    splat_triangles::Image picture() {
        return {image.data(), alpha.data(), transmittance.data(), geometry ? normal.data() : nullptr,
                geometry ? depth.data() : nullptr};
    }
    splat_triangles::ImageGradient upstream() {
        return {up_image.data(), up_alpha.data(), geometry ? up_normal.data() : nullptr,
                geometry ? up_depth.data() : nullptr, picture()};
    }
    splat_triangles::MeshGradient gradient() {
        return {to_xyz.data(), to_values.data(), to_opacity.data(), to_sigma.data()};
    }

    void expect_finite_results(unsigned seed) const {
        for (const Floats* values_of : {&image, &alpha, &transmittance, &normal, &depth, &weight}) {
            expect_finite(*values_of, "image of splatted triangles", seed);
        }
        expect_finite(to_xyz, "gradient of vertices", seed);
        expect_finite(to_values, "gradient of features of triangles", seed);
        expect_finite(to_opacity, "gradient of opacity", seed);
        expect_finite(to_sigma, "gradient of sigma", seed);
    }
};

}  // namespace fourd::tests
