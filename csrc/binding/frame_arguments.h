// The arrays of a baked frame, checked and converted; on the CPU and on a GPU.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>

#include "binding/convert.h"
#include "play/frame.h"

namespace fourd {

// Half: what float16 numbers come as, their sixteen bits.
template <typename Device, typename Half>
struct FrameArguments {
    static_assert(sizeof(Half) == sizeof(std::uint16_t));
    template <typename Number, typename Shape>
    using Array = nanobind::ndarray<const Number, Shape, nanobind::c_contig, Device>;
    using Xyz = Array<float, nanobind::shape<-1, 3>>;
    using Column = Array<Half, nanobind::ndim<1>>;
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

    static play::Frame frame(const Xyz& xyz, const Column& radius, const Column& density, const Harmonics& sh,
                             const Weights& weights, const Colours& rgb) {
        play::Frame frame = bare_frame(xyz, radius, density);
        frame.points = points(xyz, sh, weights, rgb);
        return frame;
    }

    // Positions and sizes alone.
    static play::Frame bare_frame(const Xyz& xyz, const Column& radius, const Column& density) {
        const std::size_t count = xyz.shape(0);
        require(count <= 0x7fffffff, "xyz: expected at most 2^31 - 1 points");
        require(radius.shape(0) == count && density.shape(0) == count, "radius, density: expected as many points as xyz");
        return {{xyz.data(), nullptr, nullptr, nullptr, count, 0}, bits(radius.data()), bits(density.data())};
    }

  private:
    static const std::uint16_t* bits(const Half* halves) { return reinterpret_cast<const std::uint16_t*>(halves); }
};

}  // namespace fourd
