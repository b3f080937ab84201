// Random source views, and random points inside and outside their images.
#pragma once

#include "sources/sources.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

struct SourceInputs {
    Floats images, mattes, depth, features, xyz, softness;
    std::vector<sources::Pinhole> cameras;
    sources::Query query{};
    Floats samples, visibility, to_xyz, to_features;  // Results.

    SourceInputs(Random& random, float hostile) {
        const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 200)),
                          views = random_int(random, 1, 4);
        const int width = random_int(random, 1, 30), height = random_int(random, 1, 30);
        const int channels = random_int(random, 0, 2) ? 16 : random_int(random, 0, 6);
        const int across = random_int(random, 1, 20), down = random_int(random, 1, 20);
        const std::size_t pixels = static_cast<std::size_t>(width) * height;
        images = random_floats(random, 3 * views * pixels, 0, 1, 0);
        mattes = random_floats(random, views * pixels, 0, 1, 0);
        depth = random_floats(random, views * pixels, 1, 5, 0);
        features = random_floats(random, views * channels * across * down, -1, 1, 0);
        xyz = random_floats(random, 3 * count, -2, 2, hostile);
        softness = random_floats(random, count, 0.01f, 0.5f, hostile);
        for (std::size_t view = 0; view < views; ++view) {
            const points::Pinhole from = random_settings(random, "").camera;
            sources::Pinhole to{};
            for (int i = 0; i < 9; ++i) to.intrinsics[i] = from.intrinsics[i];
            for (int i = 0; i < 9; ++i) to.rotation[i] = from.rotation[i];
            for (int i = 0; i < 3; ++i) to.translation[i] = from.translation[i];
            cameras.push_back(to);
        }
        const bool occluded = random_int(random, 0, 1) == 1;
        query.maps = {images.data(),
                      mattes.data(),
                      occluded ? depth.data() : nullptr,
                      channels ? features.data() : nullptr,
                      width,
                      height,
                      channels,
                      channels ? across : 0,
                      channels ? down : 0};
        query.cameras = cameras.data();
        query.views = static_cast<int>(views);
        query.xyz = xyz.data();
        query.count = count;
        query.softness = softness.data();
        query.threads = random_int(random, 1, 4);
        samples.resize(views * (channels + 3) * count);
        visibility.resize(views * count);
        to_xyz.resize(3 * count);
        to_features.resize(features.size());
    }

    sources::Samples out() { return {samples.data(), visibility.data()}; }
    sources::Gradients gradients() { return {to_xyz.data(), features.empty() ? nullptr : to_features.data()}; }

    void expect_finite_results(unsigned seed) const {
        expect_finite(samples, "channels", seed);
        expect_finite(visibility, "visibility weight", seed);
        expect_finite(to_features, "gradient of features", seed);
    }
};

}  // namespace fourd::tests
