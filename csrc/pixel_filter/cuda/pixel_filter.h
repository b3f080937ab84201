// The pixel filter (pixel_filter/pixel_filter.h) on a GPU. The function queues work on a stream and does not wait for
// the GPU. All arrays are in GPU memory.
#pragma once

#include "pixel_filter/pixel_filter.h"

namespace fourd::pixel_filter::cuda {

void filter_pixels(const Image& image, float side, std::uint8_t* out, void* stream);

}  // namespace fourd::pixel_filter::cuda
