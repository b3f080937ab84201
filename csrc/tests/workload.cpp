// Runs one kernel on synthetic points, for profilers and for counting instructions. The program prints the milliseconds
// per repeat. KERNEL is render, backward, play, planes, planes_backward, sources, sources_backward, similarity,
// hashgrid, hashgrid_backward, heads, heads_backward, encoder, encoder_backward or moves. LAYERS is the maximum number
// of depth layers per pixel. For the hash grid, LAYERS is instead the logarithm to base 2 of the maximum number of
// entries per level.
// Usage:
//   workload KERNEL POINTS WIDTH HEIGHT LAYERS REPEATS THREADS [SIMD]
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "hashgrid/hashgrid.h"
#include "planes/planes.h"
#include "play/play.h"
#include "points/points.h"
#include "similarity/similarity.h"
#include "sources/sources.h"
#include "tests/training/workloads.h"

namespace {

using Floats = std::vector<float>;

struct Size {
    std::size_t points;
    int width, height, layers, threads;
    fourd::Simd simd;
};

// Random points on an ellipsoid that covers 40% of the image, as make_points in fourd/benchmarks/workloads.py makes
// them.
struct Figure {
    Floats xyz, features, radius, density;

    explicit Figure(std::size_t count) : xyz(3 * count), features(3 * count), radius(count), density(count) {
        std::mt19937 random(4);
        std::normal_distribution<float> normal;
        std::uniform_real_distribution<float> uniform;
        for (std::size_t i = 0; i < count; ++i) {
            const float d[3] = {normal(random), normal(random), normal(random)};
            const float scale = 1.0f / std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            for (int axis = 0; axis < 3; ++axis) xyz[3 * i + axis] = (axis < 2 ? 0.75f : 0.9f) * d[axis] * scale;
            for (int c = 0; c < 3; ++c) features[3 * i + c] = uniform(random);
            radius[i] = 1.3f * std::sqrt(8.0f / static_cast<float>(count));
            density[i] = 0.9f + 0.1f * uniform(random);
        }
    }

    fourd::points::Cloud cloud() const {
        return {xyz.data(), features.data(), radius.data(), density.data(), radius.size(), 3};
    }
};

fourd::points::Settings make_settings(const Size& size) {
    const float focal = 1.3f * static_cast<float>(size.height);
    fourd::points::Settings out{};
    const float intrinsics[9] = {focal, 0, size.width / 2.0f, 0, focal, size.height / 2.0f, 0, 0, 1};
    const float rotation[9] = {1, 0, 0, 0, 0, -1, 0, 1, 0};
    const float translation[3] = {0, 0.4f, 3};
    std::memcpy(out.camera.intrinsics, intrinsics, sizeof intrinsics);
    std::memcpy(out.camera.rotation, rotation, sizeof rotation);
    std::memcpy(out.camera.translation, translation, sizeof translation);
    out.camera.width = size.width;
    out.camera.height = size.height;
    out.near_depth = 0.01f;
    out.layers = size.layers;
    out.threads = size.threads;
    out.simd = size.simd;
    return out;
}

std::function<void()> render_workload(const Size& size, bool backward) {
    const Figure figure(size.points);
    const fourd::points::Settings settings = make_settings(size);
    const std::size_t pixels = static_cast<std::size_t>(size.width) * size.height;
    const auto workspace = std::make_shared<fourd::points::Workspace>();
    return [=, image = Floats(3 * pixels, 1.0f), alpha = Floats(pixels, 1.0f), depth = Floats(pixels),
            gradients = std::vector<Floats>{Floats(3 * size.points), Floats(3 * size.points), Floats(size.points),
                                            Floats(size.points)}]() mutable {
        if (backward) {
            fourd::points::render_backward(
                figure.cloud(), settings, *workspace, {image.data(), alpha.data(), nullptr},
                {gradients[0].data(), gradients[1].data(), gradients[2].data(), gradients[3].data()});
        } else {
            fourd::points::render(figure.cloud(), settings, *workspace, {image.data(), alpha.data(), depth.data()});
        }
    };
}

std::function<void()> play_workload(const Size& size) {
    constexpr std::size_t kViews = 17;
    const Figure figure(size.points);
    const fourd::points::Settings settings = make_settings(size);
    std::mt19937 random(5);
    const auto halves = [&](std::size_t count) {
        std::vector<std::uint16_t> out(count);
        // Random numbers from 0.125 to 0.5, as float16.
        for (auto& half : out) half = static_cast<std::uint16_t>(0x3000 + random() % 0x800);
        return out;
    };
    std::vector<std::uint16_t> radius(size.points);
    std::uint32_t bits;
    std::memcpy(&bits, figure.radius.data(), sizeof bits);
    for (auto& half : radius) half = static_cast<std::uint16_t>((bits >> 13) - (112u << 10));
    const auto player = std::make_shared<fourd::play::Player>();
    return [=, density = std::vector<std::uint16_t>(size.points, 0x3bc0), sh = halves(48 * size.points),
            weights = halves(kViews * size.points), rgb = std::vector<std::uint8_t>(3 * kViews * size.points, 90),
            chosen = std::vector<std::int32_t>{2, 3, 4, 5}, view_weights = std::vector<float>{0.7f, 0.6f, 0.3f, 0.1f},
            picture = std::vector<std::uint8_t>(std::size_t{4} * size.width * size.height)]() mutable {
        const fourd::play::Frame frame{{figure.xyz.data(), sh.data(), weights.data(), rgb.data(), size.points, kViews},
                                       radius.data(),
                                       density.data()};
        fourd::points::Settings fast = settings;
        fast.transmittance_min = 1e-3f;
        const fourd::shade::Settings shading{chosen.data(), view_weights.data(), 4,        {0, -3, 0.4}, 0.25f,
                                             0.0f,          size.threads,        size.simd};
        player->draw(frame, fast, shading, {picture.data(), {0, 0, 0}}, 0.0f);
    };
}

std::function<void()> planes_workload(const Size& size, bool backward) {
    constexpr int kFeatures = 8, kLevels = 4;
    constexpr int kPairs[6][2] = {{0, 1}, {0, 2}, {1, 2}, {0, 3}, {1, 3}, {2, 3}};
    std::mt19937 random(6);
    std::uniform_real_distribution<float> uniform(-1, 1);
    Floats coordinates(4 * size.points);
    for (std::size_t i = 0; i < coordinates.size(); ++i) coordinates[i] = i % 4 == 3 ? 0.3f : uniform(random);
    std::vector<Floats> values;
    std::vector<fourd::planes::Plane> planes;
    for (int level = 0; level < kLevels; ++level) {
        for (const auto& pair : kPairs) {
            const int columns = 64 << level, rows = pair[1] == 3 ? 24 : columns;
            values.emplace_back(static_cast<std::size_t>(columns) * rows * kFeatures, 0.1f);
            planes.push_back({nullptr, columns, rows, pair[0], pair[1]});
        }
    }
    return [=, values = values, gradients = values, planes = planes,
            samples = Floats(size.points * planes.size() * kFeatures, 0.5f)]() mutable {
        std::vector<float*> targets;
        for (std::size_t k = 0; k < planes.size(); ++k) {
            planes[k].values = values[k].data();
            targets.push_back(gradients[k].data());
        }
        const fourd::planes::Query query{
            planes.data(), static_cast<int>(planes.size()), kFeatures, coordinates.data(), size.points, size.threads,
            size.simd};
        if (backward) {
            fourd::planes::sample_backward(query, samples.data(), targets.data(), nullptr);
        } else {
            fourd::planes::sample(query, samples.data());
        }
    };
}

// Looks up a hash grid at points along random lines, like the samples along camera rays. The hash grid has 16 levels
// with 16 to 2048 cells per side, and 2 features per level. Each level has at most 2^layers entries.
std::function<void()> hashgrid_workload(const Size& size, bool backward) {
    constexpr std::size_t kPerLine = 128;
    constexpr int kLevels = 16, kFeatures = 2;
    std::mt19937 random(7);
    std::uniform_real_distribution<float> uniform;
    Floats coordinates(3 * size.points);
    float from[3], to[3];
    for (std::size_t i = 0; i < size.points; ++i) {
        for (int axis = 0; axis < 3 && i % kPerLine == 0; ++axis) {
            from[axis] = uniform(random);
            to[axis] = uniform(random);
        }
        const float share = (static_cast<float>(i % kPerLine) + uniform(random)) / kPerLine;
        for (int axis = 0; axis < 3; ++axis) coordinates[3 * i + axis] = from[axis] + share * (to[axis] - from[axis]);
    }
    std::vector<fourd::hashgrid::Level> levels;
    std::size_t entries = 0;
    for (int l = 0; l < kLevels; ++l) {
        const int resolution = static_cast<int>(16.0 * std::pow(128.0, l / 15.0) + 1e-6);
        levels.push_back(fourd::hashgrid::level_of(resolution, size.layers, entries));
        entries = levels.back().first + levels.back().entries;
    }
    return [=, table = Floats(entries * kFeatures, 0.1f), gradient = Floats(entries * kFeatures),
            out = Floats(size.points * kLevels * kFeatures, 0.5f)]() mutable {
        const fourd::hashgrid::Query query{table.data(),       entries,     levels.data(), kLevels,  kFeatures,
                                           coordinates.data(), size.points, size.threads,  size.simd};
        if (backward) {
            fourd::hashgrid::encode_backward(query, out.data(), gradient.data(), nullptr);
        } else {
            fourd::hashgrid::encode(query, out.data());
        }
    };
}

// Samples four adjacent source views, which have 16 feature channels at half the resolution of the images.
std::function<void()> sources_workload(const Size& size, bool backward) {
    constexpr int kViews = 4, kChannels = 16;
    const Figure figure(size.points);
    const fourd::points::Pinhole from = make_settings(size).camera;
    std::vector<fourd::sources::Pinhole> cameras(kViews);
    for (int view = 0; view < kViews; ++view) {
        std::memcpy(cameras[view].intrinsics, from.intrinsics, sizeof from.intrinsics);
        std::memcpy(cameras[view].rotation, from.rotation, sizeof from.rotation);
        std::memcpy(cameras[view].translation, from.translation, sizeof from.translation);
        cameras[view].translation[0] = 0.1f * static_cast<float>(view);
    }
    const std::size_t pixels = static_cast<std::size_t>(size.width) * size.height;
    return [=, images = Floats(3 * kViews * pixels, 0.4f), mattes = Floats(kViews * pixels, 1.0f),
            depth = Floats(kViews * pixels, 3.0f), features = Floats(kViews * kChannels * (pixels / 4), 0.2f),
            samples = Floats(kViews * (kChannels + 3) * size.points, 0.5f), visibility = Floats(kViews * size.points),
            to_features = Floats(kViews * kChannels * (pixels / 4)), to_xyz = Floats(3 * size.points),
            softness = Floats(size.points, 0.02f)]() mutable {
        const fourd::sources::Maps maps{images.data(), mattes.data(), depth.data(),   features.data(), size.width,
                                        size.height,   kChannels,     size.width / 2, size.height / 2};
        const fourd::sources::Query query{maps,        cameras.data(),  kViews,       figure.xyz.data(),
                                          size.points, softness.data(), size.threads, size.simd};
        if (backward) {
            fourd::sources::sample_backward(query, samples.data(), {to_xyz.data(), to_features.data()});
        } else {
            fourd::sources::sample(query, {samples.data(), visibility.data()});
        }
    };
}

std::function<void()> similarity_workload(const Size& size) {
    const std::size_t values = static_cast<std::size_t>(size.width) * size.height * 3;
    Floats picture(values), truth(values);
    for (std::size_t i = 0; i < values; ++i) {
        picture[i] = static_cast<float>(i % 97) / 97.0f;
        truth[i] = static_cast<float>(i % 89) / 89.0f;
    }
    return [=, gradient = Floats(values)]() mutable {
        fourd::similarity::similarity(
            {picture.data(), truth.data(), size.width, size.height, 3, size.threads, size.simd}, gradient.data());
    };
}

}  // namespace

int main(int count, char** arguments) {
    if (count < 8) {
        std::fprintf(stderr, "workload KERNEL POINTS WIDTH HEIGHT LAYERS REPEATS THREADS [SIMD]\n");
        return 2;
    }
    const std::string kernel = arguments[1];
    const Size size{static_cast<std::size_t>(std::atoll(arguments[2])),
                    std::atoi(arguments[3]),
                    std::atoi(arguments[4]),
                    std::atoi(arguments[5]),
                    std::atoi(arguments[7]),
                    fourd::simd_named(count > 8 ? arguments[8] : "")};
    std::function<void()> work;
    if (kernel == "render") work = render_workload(size, false);
    if (kernel == "backward") work = render_workload(size, true);
    if (kernel == "play") work = play_workload(size);
    if (kernel == "planes") work = planes_workload(size, false);
    if (kernel == "planes_backward") work = planes_workload(size, true);
    if (kernel == "hashgrid") work = hashgrid_workload(size, false);
    if (kernel == "hashgrid_backward") work = hashgrid_workload(size, true);
    if (kernel == "sources") work = sources_workload(size, false);
    if (kernel == "sources_backward") work = sources_workload(size, true);
    if (kernel == "heads") work = fourd::tests::heads_workload(size.points, size.threads, size.simd, false);
    if (kernel == "heads_backward") work = fourd::tests::heads_workload(size.points, size.threads, size.simd, true);
    if (kernel == "encoder")
        work = fourd::tests::encoder_workload(size.width, size.height, size.threads, size.simd, false);
    if (kernel == "encoder_backward")
        work = fourd::tests::encoder_workload(size.width, size.height, size.threads, size.simd, true);
    if (kernel == "moves") work = fourd::tests::moves_workload(size.points, size.threads);
    if (kernel == "similarity") work = similarity_workload(size);
    if (!work) {
        std::fprintf(stderr, "workload: no kernel %s\n", arguments[1]);
        return 2;
    }
    const int repeats = std::atoi(arguments[6]);
    const auto started = std::chrono::steady_clock::now();
    for (int i = 0; i < repeats; ++i) work();
    const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - started;
    std::printf("%.3f\n", spent.count() / repeats);
}
