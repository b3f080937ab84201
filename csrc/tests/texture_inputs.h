// Random textures of any size and filter, and random and invalid positions, footprints and biases.
#pragma once

#include <cstring>

#include "tests/random_inputs.h"
#include "texture/texture.h"

namespace fourd::tests {

struct TextureInputs {
    std::vector<Floats> levels, to_levels;
    Floats uv, uv_da, bias, out, gradient, to_uv, to_uv_da, to_bias;
    texture::Query query{};
    bool is_chain;

    TextureInputs(Random& random, int max_side, float hostile) {
        query.boundary = static_cast<texture::Boundary>(random_int(random, 0, 3));
        query.filter = static_cast<texture::Filter>(random_int(random, 0, 3));
        const bool is_cube = query.boundary == texture::Boundary::cube;
        query.pictures = static_cast<std::size_t>(random_int(random, 0, 2));
        query.pixels = static_cast<std::size_t>(random_int(random, 0, max_side * max_side));
        texture::Shape& shape = query.texture.shape;
        shape.items = query.pictures > 0 && random_int(random, 0, 1) ? query.pictures : 1;
        shape.faces = is_cube ? 6 : 1;
        shape.height = random_int(random, 1, max_side);
        shape.width = is_cube ? shape.height : random_int(random, 1, max_side);
        shape.channels = random_int(random, 1, 6);
        is_chain = random_int(random, 0, 1) == 1;
        if (is_chain) make_even(random);
        shape.level_count = is_chain || texture::uses_mips(query.filter) ? random_int(random, 1, 4) : 1;
        for (int level = 0; level < shape.level_count; ++level) {
            levels.push_back(random_floats(random, shape.items * shape.floats(level), -1, 1, 0));
            to_levels.emplace_back(levels.back().size());
            query.texture.levels[level] = levels.back().data();
        }
        const std::size_t count = query.pictures * query.pixels, coordinates = is_cube ? 3 : 2;
        uv = random_floats(random, coordinates * count, -2, 2, hostile);
        uv_da = random_floats(random, 2 * coordinates * count, -0.5f, 0.5f, hostile);
        bias = random_floats(random, count, -1, 3, hostile);
        gradient = random_floats(random, count * shape.channels, -1, 1, 0);
        out.resize(gradient.size());
        to_uv.resize(uv.size());
        to_uv_da.resize(uv_da.size());
        to_bias.resize(bias.size());
        query.uv = uv.data();
        query.uv_da = random_int(random, 0, 3) ? uv_da.data() : nullptr;
        query.bias = random_int(random, 0, 1) ? bias.data() : nullptr;
        query.threads = random_int(random, 1, 4);
    }

    // Returns pointers to the mip levels from 1 on, which build_mips() writes.
    std::vector<float*> mips() {
        std::vector<float*> pointers;
        for (std::size_t level = 1; level < levels.size(); ++level) pointers.push_back(levels[level].data());
        return pointers;
    }

    texture::Gradients gradients(bool to_texture) {
        texture::Gradients to{};
        for (std::size_t level = 0; level < levels.size() && to_texture; ++level) {
            to.levels[level] = to_levels[level].data();
        }
        to.uv = to_uv.data();
        to.uv_da = query.uv_da ? to_uv_da.data() : nullptr;
        to.bias = query.bias ? to_bias.data() : nullptr;
        return to;
    }

    void expect_finite_results(unsigned seed) const {
        expect_finite(out, "texture", seed);
        for (const Floats& level : to_levels) expect_finite(level, "gradient of a level", seed);
        // On cube maps, uv is a direction. The gradient overflows for a direction of almost zero length, so the
        // gradients below are not checked.
        if (query.boundary == texture::Boundary::cube) return;
        expect_finite(to_uv, "gradient of uv", seed);
        expect_finite(to_uv_da, "gradient of uv_da", seed);
        expect_finite(to_bias, "gradient of the bias", seed);
    }

  private:
    // Makes each side of the texture a multiple of 8, or 1, so that a chain of four mip levels can be built.
    void make_even(Random& random) {
        texture::Shape& shape = query.texture.shape;
        shape.height = random_int(random, 0, 4) ? (shape.height + 7) / 8 * 8 : 1;
        shape.width = shape.faces == 6 ? shape.height : random_int(random, 0, 4) ? (shape.width + 7) / 8 * 8 : 1;
    }
};

}  // namespace fourd::tests
