// Checks and converts the arguments of shading, for the CPU and a GPU.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <string>

#include "binding/require.h"
#include "shade/shade.h"

namespace fourd {

// The indices and weights of the views to blend, and the centre of a camera. All arrays are in host memory.
using ChosenArray = nanobind::ndarray<const std::int32_t, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;
using ViewWeightArray = nanobind::ndarray<const float, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;
using CentreArray = nanobind::ndarray<const double, nanobind::shape<3>, nanobind::c_contig, nanobind::device::cpu>;

inline shade::Settings shade_settings(const ChosenArray& chosen, const ViewWeightArray& view_weights, std::size_t views,
                                      const CentreArray& centre, float sh_range, float sh_base, int threads,
                                      const std::string& simd) {
    require(chosen.shape(0) <= shade::kMaxChosen, "chosen: expected at most 64 views");
    for (std::size_t i = 0; i < chosen.shape(0); ++i) {
        require(chosen.data()[i] >= 0 && static_cast<std::size_t>(chosen.data()[i]) < views,
                "chosen: expected indices of source views");
    }
    require(view_weights.shape(0) == chosen.shape(0), "view_weights: expected as many values as chosen");
    float total = 0.0f;
    for (std::size_t i = 0; i < view_weights.shape(0); ++i) {
        const float weight = view_weights.data()[i];
        require(weight >= 0.0f && weight <= 1.0f, "view_weights: expected values from 0 to 1");
        total += weight;
    }
    require(total > 0.0f || chosen.shape(0) == 0, "view_weights: expected at least one value above 0");
    return {chosen.data(),
            view_weights.data(),
            static_cast<int>(chosen.shape(0)),
            {centre.data()[0], centre.data()[1], centre.data()[2]},
            sh_range,
            sh_base,
            clamp_threads(threads),
            simd_named(simd.c_str())};
}

// The template argument Half is the element type of float16 arrays, a 16-bit integer.
template <typename Device, typename Half>
struct ShadeArguments {
    static_assert(sizeof(Half) == sizeof(std::uint16_t));
    template <typename Number, typename Shape>
    using Array = nanobind::ndarray<const Number, Shape, nanobind::c_contig, Device>;
    using Xyz = Array<float, nanobind::shape<-1, 3>>;
    using Harmonics = Array<Half, nanobind::shape<-1, 3, 16>>;
    using Weights = Array<Half, nanobind::ndim<2>>;
    using Colours = Array<std::uint8_t, nanobind::shape<-1, -1, 3>>;

    static shade::Points points(const Xyz& xyz, const Harmonics& sh, const Weights& weights, const Colours& rgb) {
        const std::size_t count = xyz.shape(0), views = weights.shape(1);
        require(count <= 0x7fffffff, "xyz: expected at most 2^31 - 1 points");
        require(sh.shape(0) == count, "sh: expected as many points as xyz");
        require(weights.shape(0) == count, "blend_weights: expected as many points as xyz");
        require(rgb.shape(0) == count && rgb.shape(1) == views, "rgb: expected the shape of blend_weights and 3");
        return {xyz.data(), bits(sh.data()), bits(weights.data()), rgb.data(), count, views};
    }

    static const std::uint16_t* bits(const Half* halves) { return reinterpret_cast<const std::uint16_t*>(halves); }
};

}  // namespace fourd
