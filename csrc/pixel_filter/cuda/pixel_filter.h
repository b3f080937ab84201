// The pixel filter (pixel_filter/pixel_filter.h) on a GPU. The function is asynchronous, as in points/cuda/render.h, and
// all arrays are in GPU memory.
#pragma once

#include "pixel_filter/pixel_filter.h"

namespace fourd::pixel_filter::cuda {

void filter_pixels(const Image& image, float side, std::uint8_t* out, void* stream);

}  // namespace fourd::pixel_filter::cuda
