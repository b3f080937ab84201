// Checks the arguments of the pixel filter, for the CPU and a GPU.
#pragma once

#include <nanobind/ndarray.h>

#include "binding/require.h"
#include "pixel_filter/pixel_filter.h"

namespace fourd {

template <typename Number, typename Where>
using PixelArray = nanobind::ndarray<Number, nanobind::shape<-1, -1, 4>, nanobind::c_contig, Where>;

// Returns the input image. Throws std::invalid_argument if `side` is out of range, if a size is invalid, or if `out`
// overlaps the image in memory.
template <typename Where>
pixel_filter::Image filter_image(const PixelArray<const std::uint8_t, Where>& image, float side,
                                 const PixelArray<std::uint8_t, Where>& out) {
    require(side >= 0.0f && side <= 0.25f, "side: expected a weight from 0 to 0.25");
    for (int axis = 0; axis < 2; ++axis) {
        require(image.shape(axis) <= (1 << 18), "image: expected at most 262144 pixels per side");
        require(out.shape(axis) == image.shape(axis), "out: expected the size of image");
    }
    require(image.size() == 0 || out.data() >= image.data() + image.size() || image.data() >= out.data() + out.size(),
            "out: expected memory that does not overlap the image");
    return {image.data(), static_cast<int>(image.shape(1)), static_cast<int>(image.shape(0))};
}

}  // namespace fourd
