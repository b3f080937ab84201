// Checks and converts the arrays of a baked frame (play/frame.h), for the CPU and a GPU.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>

#include "play/frame.h"
#include "shade/arguments.h"

namespace fourd {

template <typename Device, typename Half>
struct FrameArguments : ShadeArguments<Device, Half> {
    using Base = ShadeArguments<Device, Half>;
    using typename Base::Colours;
    using typename Base::Harmonics;
    using typename Base::Weights;
    using typename Base::Xyz;
    using Column = typename Base::template Array<Half, nanobind::ndim<1>>;

    static play::Frame frame(const Xyz& xyz, const Column& radius, const Column& density, const Harmonics& sh,
                             const Weights& weights, const Colours& rgb) {
        play::Frame frame = bare_frame(xyz, radius, density);
        frame.points = Base::points(xyz, sh, weights, rgb);
        return frame;
    }

    // Makes a frame that has only positions, radii and densities.
    static play::Frame bare_frame(const Xyz& xyz, const Column& radius, const Column& density) {
        const std::size_t count = xyz.shape(0);
        require(count <= 0x7fffffff, "xyz: expected at most 2^31 - 1 points");
        require(radius.shape(0) == count && density.shape(0) == count,
                "radius, density: expected as many points as xyz");
        return {
            {xyz.data(), nullptr, nullptr, nullptr, count, 0}, Base::bits(radius.data()), Base::bits(density.data())};
    }
};

}  // namespace fourd
