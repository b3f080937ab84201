#include "common/half.h"
#include "unpack/unpack.h"

namespace fourd::unpack {
namespace FOURD_SIMD {
namespace {

constexpr std::size_t kBlock = 64;  // Points whose output fits into the first-level cache.

void harmonics(const Harmonics& from, std::uint16_t* out) {
    alignas(64) float factors[kShNumbers][kBlock];
    alignas(64) std::uint16_t halves[kShNumbers][kBlock];
    for (std::size_t first = 0; first < from.points; first += kBlock) {
        const std::size_t count = from.points - first < kBlock ? from.points - first : kBlock;
        for (std::size_t row = 0; row < from.rows; ++row) {
            const std::uint8_t* const low = from.low + row * from.points + first;
            const std::uint8_t* const high = from.high + row * from.points + first;
            for (std::size_t i = 0; i < count; ++i) {
                const int code = low[i] | high[i] << 8;
                factors[row][i] = static_cast<float>((code >> 1) ^ -(code & 1));
            }
        }
        for (int number = 0; number < kShNumbers; ++number) {
            alignas(64) float sums[kBlock];
            for (std::size_t i = 0; i < kBlock; ++i) sums[i] = from.mean[number];
            for (std::size_t row = 0; row < from.rows; ++row) {
                const float scale = from.basis[row * kShNumbers + number];
                for (std::size_t i = 0; i < kBlock; ++i) sums[i] += scale * factors[row][i];
            }
            for (std::size_t i = 0; i < kBlock; ++i) halves[number][i] = to_half(sums[i]);
        }
        for (std::size_t i = 0; i < count; ++i) {
            std::uint16_t* const to = out + (first + i) * kShNumbers;
            for (int number = 0; number < kShNumbers; ++number) to[number] = halves[number][i];
        }
    }
}

// Adds `step` times a level, which is a signed byte, to a colour. With a step of 1, sums wrap around, so that levels
// represent all differences of colours.
FOURD_INLINE std::uint8_t add_level(std::uint8_t mean, std::uint8_t level, int step) {
    const int sum = mean + step * static_cast<std::int8_t>(level);
    const int clamped = sum < 0 ? 0 : (sum > 255 ? 255 : sum);
    return static_cast<std::uint8_t>(step == 1 ? sum : clamped);
}

// Writes one view of `count` points. Returns the number of colours that were read. Points without a colour also read a
// level, which is then masked. A branch would be slower, because the processor cannot predict it.
std::size_t view(const Views& from, std::size_t number, std::size_t first, std::size_t count, std::size_t next,
                 std::uint16_t* out_weights, std::uint8_t* out_rgb) {
    const View& of = from.views[number];
    const std::size_t last = of.colours > 0 ? of.colours - 1 : 0;
    for (std::size_t i = first; i < first + count; ++i) {
        const std::uint8_t code = of.codes[i];
        const bool has_colour = of.colours > 0 && (code != 0 || from.every_point_has_colours);
        const std::uint8_t* const level = of.levels + (next < last ? next : last);
        const std::uint8_t used = has_colour ? 0xff : 0;
        const std::uint8_t green = of.colours > 0 ? level[0] & used : 0;
        const std::uint8_t red = of.colours > 0 ? level[of.colours] & used : 0;
        const std::uint8_t blue = of.colours > 0 ? level[2 * of.colours] & used : 0;
        next += has_colour;
        out_weights[i * from.view_count + number] = from.weights[code];
        const std::uint8_t* const mean = from.mean + 3 * i;
        std::uint8_t* const rgb = out_rgb + 3 * (i * from.view_count + number);
        rgb[0] = add_level(mean[0], static_cast<std::uint8_t>(green + red), from.colour_step);
        rgb[1] = add_level(mean[1], green, from.colour_step);
        rgb[2] = add_level(mean[2], static_cast<std::uint8_t>(green + blue), from.colour_step);
    }
    return next;
}

void views(const Views& from, std::size_t* next, std::uint16_t* out_weights, std::uint8_t* out_rgb) {
    for (std::size_t number = 0; number < from.view_count; ++number) next[number] = 0;
    for (std::size_t first = 0; first < from.points; first += kBlock) {
        const std::size_t count = from.points - first < kBlock ? from.points - first : kBlock;
        for (std::size_t number = 0; number < from.view_count; ++number) {
            next[number] = view(from, number, first, count, next[number], out_weights, out_rgb);
        }
    }
}

}  // namespace

const Loops loops = {harmonics, views};

}  // namespace FOURD_SIMD
}  // namespace fourd::unpack
