// The filter is separable: a run (kRun consecutive pixels of a row), with one more pixel on each side, is filtered
// first along columns, then along the row. If the pixels of a run and all their neighbours have the same colour, for
// example in the background, the run is copied without filtering.
#include "pixel_filter/cpu/loops.h"

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "pixel_filter/maths.h"

namespace fourd::pixel_filter::FOURD_SIMD {
namespace {

constexpr int kRun = 64;

// Filters `count` bytes along columns, from byte `first` of the row on. out[i] is the weighted mean of three bytes: the
// byte first + i of rows.centre, the byte above it and the byte below it.
FOURD_INLINE void filter_columns(const Rows& rows, std::size_t first, int count, float side, float* FOURD_RESTRICT out) {
    const std::uint8_t *above = rows.above + first, *centre = rows.centre + first, *below = rows.below + first;
    for (int i = 0; i < count; ++i) out[i] = mean_of(above[i], centre[i], below[i], side);
}

FOURD_INLINE std::uint32_t load_pixel(const std::uint8_t* row, std::size_t pixel) {
    std::uint32_t word;
    std::memcpy(&word, row + kChannels * pixel, sizeof word);
    return word;
}

// Returns true if the pixels [begin, end) of the three rows are all equal.
FOURD_INLINE bool is_one_colour(const Rows& rows, std::size_t begin, std::size_t end) {
    const std::uint32_t first = load_pixel(rows.centre, begin);
    std::uint32_t different = 0;
    for (std::size_t pixel = begin; pixel < end; ++pixel) {
        different |= (load_pixel(rows.above, pixel) ^ first) | (load_pixel(rows.centre, pixel) ^ first) |
                     (load_pixel(rows.below, pixel) ^ first);
    }
    return different == 0;
}

FOURD_INLINE void filter_run(const Rows& rows, int width, int begin, int end, float side,
                             std::uint8_t* FOURD_RESTRICT out) {
    const int left = begin > 0 ? begin - 1 : 0, right = end < width ? end : width - 1;
    const int count = kChannels * (end - begin);
    const auto byte_of = [](int pixel) FOURD_INLINE_LAMBDA { return static_cast<std::size_t>(kChannels) * pixel; };
    if (is_one_colour(rows, static_cast<std::size_t>(left), static_cast<std::size_t>(right) + 1)) {
        std::memcpy(out + byte_of(begin), rows.centre + byte_of(begin), static_cast<std::size_t>(count));
        return;
    }
    float columns[kChannels * (kRun + 2)];
    filter_columns(rows, byte_of(left), kChannels, side, columns);
    filter_columns(rows, byte_of(begin), count, side, columns + kChannels);
    filter_columns(rows, byte_of(right), kChannels, side, columns + kChannels + count);
    std::uint8_t* FOURD_RESTRICT first = out + byte_of(begin);
    for (int i = 0; i < count; ++i) {
        first[i] = to_byte(mean_of(columns[i], columns[i + kChannels], columns[i + 2 * kChannels], side));
    }
}

void filter_row(const Rows& rows, int width, int begin, int end, float side, std::uint8_t* out) {
    for (int first = begin; first < end; first += kRun) {
        filter_run(rows, width, first, first + kRun < end ? first + kRun : end, side, out);
    }
}

}  // namespace

const Loops loops = {filter_row};

}  // namespace fourd::pixel_filter::FOURD_SIMD
