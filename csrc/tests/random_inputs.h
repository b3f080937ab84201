// Random and invalid inputs for kernels, generated from a seed.
#pragma once

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <thread>
#include <vector>

#include "points/points.h"

namespace fourd::tests {

using Random = std::mt19937;
using Floats = std::vector<float>;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kHostile[] = {kNan, kInfinity, -kInfinity, 3e38f, -3e38f, 1e-42f, 0.0f, -0.0f, -1.0f};

inline float uniform(Random& random, float low, float high) {
    return std::uniform_real_distribution<float>(low, high)(random);
}

inline int random_int(Random& random, int low, int high) {
    return std::uniform_int_distribution<int>(low, high)(random);
}

inline void expect_finite(const Floats& values, const char* what, unsigned seed) {
    for (const float value : values) {
        if (std::isfinite(value)) continue;
        std::fprintf(stderr, "seed %u: %s: expected finite values, got %g\n", seed, what, static_cast<double>(value));
        std::exit(1);
    }
}

inline Floats random_floats(Random& random, std::size_t count, float low, float high, float hostile_share) {
    Floats values(count);
    for (float& value : values) {
        value = uniform(random, low, high);
        if (uniform(random, 0, 1) < hostile_share) value = kHostile[random_int(random, 0, 8)];
    }
    return values;
}

// Calls body(seed) for the seeds [0, count) in three threads, so that calls of the kernels overlap.
template <typename Body>
void for_seeds(unsigned count, const Body& body) {
    constexpr unsigned kCallers = 3;
    std::vector<std::thread> callers;
    for (unsigned caller = 0; caller < kCallers; ++caller) {
        callers.emplace_back([=] {
            for (unsigned seed = caller; seed < count; seed += kCallers) body(seed);
        });
    }
    for (std::thread& caller : callers) caller.join();
}

inline points::Settings random_settings(Random& random, const char* simd) {
    points::Settings settings{};
    const int width = random_int(random, 1, 70), height = random_int(random, 1, 50);
    const float focal = uniform(random, 1, 100);
    const float intrinsics[9] = {focal, 0, width / 2.0f, 0, focal, height / 2.0f, 0, 0, 1};
    const float rotation[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const float translation[3] = {0, 0, uniform(random, -1, 4)};
    for (int i = 0; i < 9; ++i) settings.camera.intrinsics[i] = intrinsics[i];
    for (int i = 0; i < 9; ++i) settings.camera.rotation[i] = rotation[i];
    for (int i = 0; i < 3; ++i) settings.camera.translation[i] = translation[i];
    settings.camera.width = width;
    settings.camera.height = height;
    settings.near_depth = 0.01f;
    settings.layers = random_int(random, 1, 30);
    settings.threads = random_int(random, 1, 4);
    settings.simd = simd_named(simd);
    return settings;
}

}  // namespace fourd::tests
