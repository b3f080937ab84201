// Python binding of the pixel filter on a GPU. fourd/rendering/ops/pixel_filter/cuda.py documents the operation.
#include "binding/cuda_arrays.h"
#include "pixel_filter/arguments.h"
#include "pixel_filter/cuda/pixel_filter.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

void run(const PixelArray<const std::uint8_t, Where>& image, float side, std::uintptr_t stream,
         const PixelArray<std::uint8_t, Where>& out) {
    pixel_filter::cuda::filter_pixels(filter_image<Where>(image, side, out), side, out.data(), stream_of(stream));
}

}  // namespace

void bind_pixel_filter(nb::module_& module) {
    module.def("filter_pixels", &run, nb::arg("image"), nb::arg("side"), nb::arg("stream"), nb::arg("out"));
}

}  // namespace fourd::cuda
