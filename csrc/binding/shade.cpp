// Checks and converts; csrc/shade knows no framework.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <string>

#include "binding/bindings.h"
#include "shade/shade.h"

namespace nb = nanobind;

namespace {

using Xyz = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Harmonics = nb::ndarray<const std::uint16_t, nb::shape<-1, 3, 16>, nb::c_contig, nb::device::cpu>;
using Weights = nb::ndarray<const std::uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Colours = nb::ndarray<const std::uint8_t, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;
using Chosen = nb::ndarray<const std::int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Centre = nb::ndarray<const double, nb::shape<3>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, float, nb::shape<-1, 3>>;

void require(bool condition, const char* message) {
    if (!condition) throw nb::value_error(message);
}

Output shade_points(Xyz xyz, Harmonics sh, Weights weights, Colours rgb, Chosen chosen, Centre centre,
                    float sh_range, float sh_base, int threads) {
    const std::size_t count = xyz.shape(0), views = weights.shape(1);
    require(sh.shape(0) == count, "sh: expected as many points as xyz");
    require(weights.shape(0) == count, "blend_weights: expected as many points as xyz");
    require(rgb.shape(0) == count && rgb.shape(1) == views, "rgb: expected the shape of blend_weights and 3");
    require(chosen.shape(0) <= fourd::shade::kMaxChosen, "chosen: expected at most 64 views");
    for (std::size_t i = 0; i < chosen.shape(0); ++i)
        require(chosen.data()[i] >= 0 && static_cast<std::size_t>(chosen.data()[i]) < views,
                "chosen: expected indices of source views");
    const fourd::shade::Points points{xyz.data(), sh.data(), weights.data(), rgb.data(), count, views};
    const fourd::shade::Settings settings{chosen.data(),
                                          static_cast<int>(chosen.shape(0)),
                                          {centre.data()[0], centre.data()[1], centre.data()[2]},
                                          sh_range,
                                          sh_base,
                                          std::clamp(threads, 1, 256)};
    float* out = new float[std::max<std::size_t>(3 * count, 1)];
    nb::capsule owner(out, [](void* data) noexcept { delete[] static_cast<float*>(data); });
    {
        nb::gil_scoped_release release;
        fourd::shade::shade(points, settings, out);
    }
    return Output(out, {count, 3}, owner);
}

}  // namespace

namespace fourd {

void bind_shade(nb::module_& module) {
    module.def("shade", &shade_points, nb::arg("xyz"), nb::arg("sh"), nb::arg("blend_weights"), nb::arg("rgb"),
               nb::arg("chosen"), nb::arg("centre"), nb::arg("sh_range"), nb::arg("sh_base"), nb::arg("threads"),
               "Colour (N, 3) of baked points; float16 arrays come as their uint16 bits. "
               "See fourd.baking.shade for what it computes.");
}

}  // namespace fourd
