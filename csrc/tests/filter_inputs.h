// Random inputs of the pixel filter.
#pragma once

#include <cstdint>
#include <vector>

#include "pixel_filter/pixel_filter.h"
#include "tests/random_inputs.h"
#include "tests/unpack_inputs.h"

namespace fourd::tests {

// An image of random bytes and a size that may be empty, and a random weight.
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
