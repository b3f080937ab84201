#include "pixel_filter/cuda/pixel_filter.h"

#include <cstddef>

#include "device/executor.h"
#include "pixel_filter/maths.h"

namespace fourd::pixel_filter::cuda {
namespace {

struct FilterPixel {
    Image image;
    float side;
    std::uint8_t* out;

    FOURD_DEVICE const std::uint8_t* pixel(int row, int column) const {
        const int y = row < 0 ? 0 : row < image.height ? row : image.height - 1;
        const int x = column < 0 ? 0 : column < image.width ? column : image.width - 1;
        return image.rgba + 4 * (static_cast<std::size_t>(y) * image.width + x);
    }

    FOURD_DEVICE void operator()(std::size_t index) const {
        const int row = static_cast<int>(index / image.width), column = static_cast<int>(index % image.width);
        float columns[3][4];
        for (int x = 0; x < 3; ++x) {
            const std::uint8_t* const above = pixel(row - 1, column + x - 1);
            const std::uint8_t* const centre = pixel(row, column + x - 1);
            const std::uint8_t* const below = pixel(row + 1, column + x - 1);
            for (int c = 0; c < 4; ++c) columns[x][c] = mean_of(above[c], centre[c], below[c], side);
        }
        for (int c = 0; c < 4; ++c) {
            out[4 * index + c] = to_byte(mean_of(columns[0][c], columns[1][c], columns[2][c], side));
        }
    }
};

}  // namespace

void filter_pixels(const Image& image, float side, std::uint8_t* out, void* stream) {
    const std::size_t pixels = static_cast<std::size_t>(image.width) * image.height;
    device::Executor(stream).for_each(pixels, FilterPixel{image, side, out});
}

}  // namespace fourd::pixel_filter::cuda
