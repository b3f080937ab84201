// Random contents of the members (files) of packed scenes, with the sizes that the binding requires.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "tests/random_inputs.h"
#include "unpack/unpack.h"

namespace fourd::tests {

using Bytes = std::vector<std::uint8_t>;

inline Bytes random_bytes(Random& random, std::size_t count) {
    Bytes bytes(count);
    for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random_int(random, 0, 255));
    return bytes;
}

// Decodes random positions, views and spherical harmonics. The values are arbitrary, so only memory accesses are
// checked, not results.
inline void run_unpack(unsigned seed, const char* simd) {
    Random random(seed);
    const unpack::Loops& loops = unpack::select_loops(simd_named(simd));
    const std::size_t points = static_cast<std::size_t>(random_int(random, 0, 200));
    const std::size_t rows = static_cast<std::size_t>(random_int(random, 0, unpack::kShNumbers));
    const Bytes factors = random_bytes(random, 2 * rows * points);
    const Floats basis = random_floats(random, rows * unpack::kShNumbers, -1, 1, 0.1f);
    const Floats mean_sh = random_floats(random, unpack::kShNumbers, -1, 1, 0.1f);
    std::vector<std::uint16_t> sh(points * unpack::kShNumbers);
    loops.harmonics({factors.data(), factors.data() + rows * points, rows, points, basis.data(), mean_sh.data()},
                    sh.data());

    const int code_bytes = random_int(random, 1, 8);
    const Bytes planes = random_bytes(random, static_cast<std::size_t>(code_bytes) * points);
    const double lower[3] = {-1, 0, 1};
    Floats xyz(3 * points);
    unpack::positions({planes.data(), code_bytes, points, lower, 0.01}, xyz.data());

    const bool all = seed % 2 == 0;
    const std::size_t count = static_cast<std::size_t>(random_int(random, 0, 5));
    std::vector<Bytes> contents;
    std::vector<unpack::View> views;
    for (std::size_t v = 0; v < count; ++v) {
        Bytes codes = random_bytes(random, points);
        for (std::uint8_t& code : codes) code = random_int(random, 0, 3) < static_cast<int>(v) ? code : 0;
        const auto none = std::count(codes.begin(), codes.end(), std::uint8_t{0});
        const std::size_t colours = all ? points : points - static_cast<std::size_t>(none);
        const Bytes levels = random_bytes(random, 3 * colours);
        codes.insert(codes.end(), levels.begin(), levels.end());
        codes.shrink_to_fit();
        contents.push_back(std::move(codes));
        views.push_back({contents.back().data(), contents.back().data() + points, colours});
    }
    const Bytes mean = random_bytes(random, 3 * points);
    const std::vector<std::uint16_t> weights(unpack::kWeightCodes, 0x3c00);
    std::vector<std::size_t> next(count);
    std::vector<std::uint16_t> out_weights(points * count);
    Bytes rgb(3 * points * count);
    loops.views({views.data(), count, points, mean.data(), weights.data(), random_int(random, 1, 127), all},
                next.data(), out_weights.data(), rgb.data());
}

}  // namespace fourd::tests
