#if defined(__F16C__)
#include <immintrin.h>
#endif

#include <cstring>

#include "common/eight.h"
#include "common/half.h"
#include "common/inline.h"
#include "unpack/unpack.h"

namespace fourd::unpack {
namespace FOURD_SIMD {
namespace {

constexpr std::size_t kBlock = 64;  // Number of points per block. The output of one block fits into the L1 cache.
constexpr std::size_t kGroup = 4;   // Number of points whose sums are computed at the same time.

// A block of points, with the rows of the basis that contribute to it. A row contributes if its factor is not 0 for at
// least one point of the block.
struct Block {
    const float* rows[kShNumbers];
    float factors[kShNumbers][kBlock];
    std::size_t row_count;
};

// Reads the factors of a block. The rows of the basis are sorted by the variance of their factors, largest first, so in
// many blocks, all factors of the last rows are 0, and these rows do not contribute.
FOURD_INLINE void read_factors(const Harmonics& from, std::size_t first, std::size_t count, Block* block) {
    block->row_count = 0;
    for (std::size_t row = 0; row < from.rows; ++row) {
        const std::uint8_t* const low = from.low + row * from.points + first;
        const std::uint8_t* const high = from.high + row * from.points + first;
        float* const factors = block->factors[block->row_count];
        int any = 0;
        for (std::size_t i = 0; i < count; ++i) {
            const int code = low[i] | high[i] << 8;
            any |= code;
            factors[i] = static_cast<float>((code >> 1) ^ -(code & 1));
        }
        for (std::size_t i = count; i < kBlock; ++i) factors[i] = 0;
        if (any == 0) continue;
        block->rows[block->row_count] = from.basis + row * kShNumbers;
        ++block->row_count;
    }
}

// Converts floats to half precision. `count` is a multiple of 8. The F16C instruction rounds in the same way as
// to_half.
FOURD_INLINE void to_halves(const float* from, std::size_t count, std::uint16_t* to) {
#if defined(__F16C__)
    const __m256 largest = _mm256_set1_ps(65504.0f), smallest = _mm256_set1_ps(-65504.0f);
    for (std::size_t i = 0; i < count; i += 8) {
        const __m256 clamped = _mm256_max_ps(_mm256_min_ps(_mm256_loadu_ps(from + i), largest), smallest);
        const __m128i halves = _mm256_cvtps_ph(clamped, _MM_FROUND_TO_NEAREST_INT);
        std::memcpy(to + i, &halves, sizeof halves);
    }
#else
    for (std::size_t i = 0; i < count; ++i) to[i] = to_half(from[i]);
#endif
}

void harmonics(const Harmonics& from, std::uint16_t* out) {
    Block block;
    alignas(64) float sums[kBlock][kShNumbers];
    for (std::size_t first = 0; first < from.points; first += kBlock) {
        const std::size_t count = from.points - first < kBlock ? from.points - first : kBlock;
        read_factors(from, first, count, &block);
        for (std::size_t i = 0; i < count; i += kGroup) {
            for_eights(kShNumbers, [&](std::size_t number, auto tag) {
                using Number = NumberOf<decltype(tag)>;
                Number a, b, c, d, row;
                load(from.mean + number, &a);
                b = c = d = a;
                for (std::size_t k = 0; k < block.row_count; ++k) {
                    const float* const factors = block.factors[k] + i;
                    load(block.rows[k] + number, &row);
                    a += row * factors[0];
                    b += row * factors[1];
                    c += row * factors[2];
                    d += row * factors[3];
                }
                store(&a, sums[i] + number);
                store(&b, sums[i + 1] + number);
                store(&c, sums[i + 2] + number);
                store(&d, sums[i + 3] + number);
            });
        }
        to_halves(sums[0], count * kShNumbers, out + first * kShNumbers);
    }
}

// Adds step * level to one channel of a colour, where the level is a signed byte. If the step is 1, sums wrap around
// modulo 256, so that one byte can represent every difference of two channel values. If the step is larger, sums are
// clamped to [0, 255].
FOURD_INLINE std::uint8_t add_level(std::uint8_t mean, std::uint8_t level, int step) {
    const int sum = mean + step * static_cast<std::int8_t>(level);
    const int clamped = sum < 0 ? 0 : (sum > 255 ? 255 : sum);
    return static_cast<std::uint8_t>(step == 1 ? sum : clamped);
}

// Writes the weight and the colour of point `i` in the view with the index `number`. `level` has three bytes, modulo
// 256: the level (see add_level) of green, the level of red minus that of green, and the level of blue minus that of
// green.
FOURD_INLINE void write_point(const Views& from, std::size_t number, std::size_t i, const std::uint8_t (&level)[3],
                              std::uint16_t* out_weights, std::uint8_t* out_rgb) {
    out_weights[i * from.view_count + number] = from.weights[from.views[number].codes[i]];
    const std::uint8_t* const mean = from.mean + 3 * i;
    std::uint8_t* const rgb = out_rgb + 3 * (i * from.view_count + number);
    rgb[0] = add_level(mean[0], static_cast<std::uint8_t>(level[0] + level[1]), from.colour_step);
    rgb[1] = add_level(mean[1], level[0], from.colour_step);
    rgb[2] = add_level(mean[2], static_cast<std::uint8_t>(level[0] + level[2]), from.colour_step);
}

// Writes the weights and the colours of `count` points in one view, for scenes in which every point has colours.
void view_of_all(const Views& from, std::size_t number, std::size_t first, std::size_t count,
                 std::uint16_t* out_weights, std::uint8_t* out_rgb) {
    const View& of = from.views[number];
    for (std::size_t i = first; i < first + count; ++i) {
        const std::uint8_t level[3] = {of.levels[i], of.levels[of.colours + i], of.levels[2 * of.colours + i]};
        write_point(from, number, i, level, out_weights, out_rgb);
    }
}

// Writes the weights and the colours of `count` points in one view, for scenes in which only some points have a colour
// in the view. Each plane of View::levels has one byte (a colour level) for each point with a colour, and no bytes for
// the other points. `next` is the index, in such a plane, of the first point of the batch that has a colour. Returns
// this index for the next batch. For points without a colour, the function also reads levels, which are then masked to
// 0, because a branch would be slower: the processor could not predict it.
std::size_t view_of_some(const Views& from, std::size_t number, std::size_t first, std::size_t count, std::size_t next,
                         std::uint16_t* out_weights, std::uint8_t* out_rgb) {
    const View& of = from.views[number];
    const std::size_t last = of.colours > 0 ? of.colours - 1 : 0;
    for (std::size_t i = first; i < first + count; ++i) {
        const bool has_colour = of.codes[i] != 0;
        const std::uint8_t* const levels = of.levels + (next < last ? next : last);
        const std::uint8_t used = has_colour ? 0xff : 0;
        std::uint8_t level[3] = {0, 0, 0};
        for (std::size_t plane = 0; plane < 3; ++plane) {
            if (of.colours > 0) level[plane] = levels[plane * of.colours] & used;
        }
        next += has_colour;
        write_point(from, number, i, level, out_weights, out_rgb);
    }
    return next;
}

void views(const Views& from, std::size_t* next, std::uint16_t* out_weights, std::uint8_t* out_rgb) {
    for (std::size_t number = 0; number < from.view_count; ++number) next[number] = 0;
    for (std::size_t first = 0; first < from.points; first += kBlock) {
        const std::size_t count = from.points - first < kBlock ? from.points - first : kBlock;
        for (std::size_t number = 0; number < from.view_count; ++number) {
            if (from.every_point_has_colours) {
                view_of_all(from, number, first, count, out_weights, out_rgb);
            } else {
                next[number] = view_of_some(from, number, first, count, next[number], out_weights, out_rgb);
            }
        }
    }
}

}  // namespace

const Loops loops = {harmonics, views};

}  // namespace FOURD_SIMD
}  // namespace fourd::unpack
