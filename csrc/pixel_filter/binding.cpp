// Python binding of the pixel filter. fourd/rendering/ops/pixel_filter/op.py documents the operation.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <string>

#include "pixel_filter/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Where = nb::device::cpu;

void run(const PixelArray<const std::uint8_t, Where>& image, float side, int threads, const std::string& simd,
         const PixelArray<std::uint8_t, Where>& out) {
    const pixel_filter::Image checked = filter_image<Where>(image, side, out);
    nb::gil_scoped_release release;
    pixel_filter::filter_pixels(checked, side, clamp_threads(threads), simd_named(simd.c_str()), out.data());
}

}  // namespace

void bind_pixel_filter(nb::module_& module) {
    module.def("filter_pixels", &run, nb::arg("image"), nb::arg("side"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("out"),
               "Sizes: image=H,W out=H,W");
}

}  // namespace fourd
