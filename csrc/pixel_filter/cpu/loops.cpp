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
constexpr int kChannels = 4;

// A row of the image, with the rows above and below it.
struct Rows {
    const std::uint8_t *above, *centre, *below;
};

FOURD_INLINE Rows rows_around(const Image& image, int row) {
    const std::size_t stride = static_cast<std::size_t>(kChannels) * image.width;
    const auto at = [&](int y) FOURD_INLINE_LAMBDA {
        return image.rgba + stride * static_cast<std::size_t>(y < 0 ? 0 : y < image.height ? y : image.height - 1);
    };
    return {at(row - 1), at(row), at(row + 1)};
}

// Computes the means along columns for `count` bytes of the rows, starting with byte `first`.
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

FOURD_INLINE void filter_run(const Image& image, const Rows& rows, int begin, int end, float side,
                             std::uint8_t* FOURD_RESTRICT out) {
    const int left = begin > 0 ? begin - 1 : 0, right = end < image.width ? end : image.width - 1;
    const int count = kChannels * (end - begin);
    const auto byte_of = [](int pixel) FOURD_INLINE_LAMBDA { return static_cast<std::size_t>(kChannels) * pixel; };
    if (is_one_colour(rows, static_cast<std::size_t>(left), static_cast<std::size_t>(right) + 1)) {
        std::memcpy(out, rows.centre + byte_of(begin), static_cast<std::size_t>(count));
        return;
    }
    float columns[kChannels * (kRun + 2)];
    filter_columns(rows, byte_of(left), kChannels, side, columns);
    filter_columns(rows, byte_of(begin), count, side, columns + kChannels);
    filter_columns(rows, byte_of(right), kChannels, side, columns + kChannels + count);
    for (int i = 0; i < count; ++i) {
        out[i] = to_byte(mean_of(columns[i], columns[i + kChannels], columns[i + 2 * kChannels], side));
    }
}

void filter_rows(const Image& image, float side, int begin, int end, std::uint8_t* out) {
    for (int row = begin; row < end; ++row) {
        const Rows rows = rows_around(image, row);
        for (int first = 0; first < image.width; first += kRun) {
            const int next = first + kRun < image.width ? first + kRun : image.width;
            const std::size_t pixel = static_cast<std::size_t>(row) * image.width + first;
            filter_run(image, rows, first, next, side, out + kChannels * pixel);
        }
    }
}

}  // namespace

const Loops loops = {filter_rows};

}  // namespace fourd::pixel_filter::FOURD_SIMD
