// Random and invalid inputs for the stylizer, for drawing visible surfaces, and for the pixel filter.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include "pixel_filter/pixel_filter.h"
#include "play/play.h"
#include "stylize/stylize.h"
#include "tests/random_inputs.h"
#include "tests/unpack_inputs.h"

namespace fourd::tests {

// Stylizes a surface whose colours and normals are random bytes, and whose depths may be infinite, NaN or negative.
inline void run_stylize(unsigned seed, const char* simd) {
    Random random(seed);
    const int width = random_int(random, 0, 150), height = random_int(random, 0, 40);
    const std::size_t pixels = static_cast<std::size_t>(width) * height;
    const auto depths = random_floats(random, pixels, -0.5f, 2.0f, seed % 2 ? 0.2f : 0.0f);
    const auto albedo = random_bytes(random, 4 * pixels), normal = random_bytes(random, 4 * pixels);
    const auto states = random_bytes(random, 4 * pixels);
    std::vector<std::uint32_t> lines(pixels);
    if (pixels > 0) std::memcpy(lines.data(), states.data(), states.size());
    std::vector<std::uint8_t> out(4 * pixels);
    stylize::Style style{};
    const auto numbers = random_floats(random, sizeof style.numbers / sizeof(float), -2.0f, 2.0f, 0.0f);
    std::memcpy(&style.numbers, numbers.data(), sizeof style.numbers);
    style.numbers.depth_threshold = style.numbers.normal_threshold = style.numbers.angle_softness = 0.01f;
    style.numbers.hatch_spacing = 1.0f + static_cast<float>(random_int(random, 0, 9));
    style.numbers.hysteresis = style.numbers.persistence = 0.5f;
    style.detail = static_cast<stylize::Detail>(random_int(random, 0, 2));
    style.lines = static_cast<stylize::Lines>(random_int(random, 0, 2));
    style.thickness = random_int(random, 1, stylize::kMaxThickness);
    style.rows = random_int(random, 1, stylize::kMaxRows);
    const std::vector<std::uint32_t> table(static_cast<std::size_t>(style.rows) * stylize::kTones, 0x00c08040u);
    style.table = table.data();
    stylize::stylize({albedo.data(), depths.data(), normal.data(), width, height}, style,
                            random_int(random, 1, 3), simd_named(simd), seed % 3 ? lines.data() : nullptr, out.data());
}

// Draws the visible surface of a frame twice, so that the second surface is averaged with the first.
inline void draw_surfaces(Random& random, play::Player& player, play::Frame frame, const points::Settings& settings,
                          const shade::Settings& shading) {
    const std::size_t pixels = static_cast<std::size_t>(settings.camera.width) * settings.camera.height;
    const auto octahedral = random_bytes(random, 2 * frame.points.count);
    std::vector<std::uint8_t> rgba(4 * pixels), normal(4 * pixels);
    std::vector<float> depths(pixels);
    frame.normals = octahedral.data();
    for (const float persistence : {0.0f, 0.9f}) {
        player.draw_surface(frame, settings, shading,
                            {{rgba.data(), {0, 0, 0}}, depths.data(), normal.data(), persistence});
    }
}

// An image of random bytes, which may be empty, and a random weight `side` of the pixel filter.
struct FilterInput {
    int width, height;
    float side;
    std::vector<std::uint8_t> rgba, out;

    explicit FilterInput(Random& random)
        : width(random_int(random, 0, 600)), height(random_int(random, 0, 70)), side(0.25f / random_int(random, 1, 9)) {
        const std::size_t bytes = std::size_t{4} * width * height;
        rgba = random_bytes(random, bytes);
        out.resize(bytes);
    }

    pixel_filter::Image image() const { return {rgba.data(), width, height}; }
};

inline void run_pixel_filter(unsigned seed, const char* simd) {
    Random random(seed);
    FilterInput input(random);
    pixel_filter::filter_pixels(input.image(), input.side, random_int(random, 1, 3), simd_named(simd), input.out.data());
}

}  // namespace fourd::tests
