// Python bindings of shading; fourd/rendering/ops/shade/op.py documents the operations.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <string>

#include "shade/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = ShadeArguments<nb::device::cpu, std::uint16_t>;
using Output = nb::ndarray<nb::numpy, float, nb::shape<-1, 3>>;

Output shade_all(const Arguments::Xyz& xyz, const Arguments::Harmonics& sh, const Arguments::Weights& weights,
                 const Arguments::Colours& rgb, const ChosenArray& chosen, const ViewWeightArray& view_weights,
                 const CentreArray& centre, float sh_range, float sh_base, int threads, const std::string& simd) {
    const shade::Points points = Arguments::points(xyz, sh, weights, rgb);
    const shade::Settings settings =
        shade_settings(chosen, view_weights, points.views, centre, sh_range, sh_base, threads, simd);
    float* out = new float[std::max<std::size_t>(3 * points.count, 1)];
    nb::capsule owner(out, [](void* data) noexcept { delete[] static_cast<float*>(data); });
    {
        nb::gil_scoped_release release;
        shade::shade(points, settings, out);
    }
    return Output(out, {points.count, 3}, owner);
}

}  // namespace

void bind_shade(nb::module_& module) {
    module.def("shade", &shade_all, nb::arg("xyz"), nb::arg("sh"), nb::arg("blend_weights"), nb::arg("rgb"),
               nb::arg("chosen"), nb::arg("view_weights"), nb::arg("centre"), nb::arg("sh_range"), nb::arg("sh_base"),
               nb::arg("threads"), nb::arg("simd"),
               "Colour (N, 3) of baked points; float16 arrays are passed as uint16 with the same bits. "
               "Documented in fourd.rendering.ops.shade.op.\n"
               "Sizes: xyz=N sh=N blend_weights=N,V rgb=N,V chosen=K chosen<V view_weights=K");
}

}  // namespace fourd
