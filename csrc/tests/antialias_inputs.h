// Random meshes and rasterizations for antialiasing, and for the gradients of moving visibility edges
// (edge_gradients/edge_gradients.h). Some indices are out of range.
#pragma once

#include <cstdint>

#include "antialias/antialias.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

struct AntialiasInputs {
    Floats positions, colours, rast, gradient;
    std::vector<int> triangles, opposite;
    antialias::Mesh mesh{};
    antialias::Images images{};
    Floats out, to_colours, to_positions;  // Results.
    std::vector<std::uint8_t> codes;

    AntialiasInputs(Random& random, int max_side, float hostile) {
        const int count = random_int(random, 0, 2), height = random_int(random, 1, max_side);
        const int width = random_int(random, 1, max_side), channels = random_int(random, 0, 5);
        const int vertices = random_int(random, 0, 30), triangle_count = random_int(random, 0, 40);
        const bool instanced = random_int(random, 0, 1) == 1;
        const std::size_t instances = instanced ? count : 1, pixels = static_cast<std::size_t>(count) * height * width;
        positions = random_floats(random, 4 * instances * vertices, -1, 1, hostile);
        colours = random_floats(random, pixels * channels, 0, 1, 0);
        gradient = random_floats(random, pixels * channels, -1, 1, 0);
        rast = random_floats(random, 4 * pixels, -1, 1, hostile);
        for (std::size_t pixel = 0; pixel < pixels; ++pixel) {
            const int triangle = random_int(random, -1, hostile > 0 ? triangle_count + 1 : triangle_count - 1);
            if (uniform(random, 0, 1) >= hostile) rast[4 * pixel + 3] = value_of_triangle(triangle);
        }
        for (int i = 0; i < 3 * triangle_count; ++i) {
            triangles.push_back(random_int(random, hostile > 0 ? -1 : 0, vertices));
            opposite.push_back(random_int(random, -2, vertices + 1));
        }
        mesh = {positions.data(),
                triangles.data(),
                opposite.data(),
                static_cast<std::size_t>(vertices),
                static_cast<std::size_t>(triangle_count),
                instanced};
        images = {colours.data(), rast.data(), static_cast<std::size_t>(count), height, width, channels};
        out.resize(colours.size()), to_colours.resize(colours.size()), to_positions.resize(positions.size());
        codes.resize(pixels);
    }

    // Fills the codes with random bytes. Usually, antialias::blend() writes the codes, one byte per pixel.
    void invent_codes(Random& random) {
        for (std::uint8_t& code : codes) code = static_cast<std::uint8_t>(random_int(random, 0, 255));
    }

    antialias::Gradients gradients() {
        return {gradient.data(), codes.data(), 2.0f, to_colours.data(), to_positions.data()};
    }

    void expect_finite_results(unsigned seed) const {
        expect_finite(out, "antialiased colours", seed);
        expect_finite(to_colours, "gradient of colours", seed);
        expect_finite(to_positions, "gradient of positions", seed);
    }
};

}  // namespace fourd::tests
