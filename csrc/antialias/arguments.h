// Checks and converts the arguments of antialiasing, for the CPU and a GPU. fourd/rendering/triangles/antialiasing.py
// checks the values of the arguments. This file checks the shapes of arrays, because a kernel would read past the end
// of an array that is too small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>

#include "antialias/antialias.h"
#include "binding/require.h"

namespace fourd {

template <typename Device>
struct AntialiasArguments {
    template <typename Number, typename Shape>
    using Array = nanobind::ndarray<Number, Shape, nanobind::c_contig, Device>;
    using Colours = Array<const float, nanobind::ndim<4>>;
    using ColoursOut = Array<float, nanobind::ndim<4>>;
    using Rast = Array<const float, nanobind::shape<-1, -1, -1, 4>>;
    using Positions = Array<const float, nanobind::shape<-1, -1, 4>>;
    using PositionsOut = Array<float, nanobind::shape<-1, -1, 4>>;
    using Triangles = Array<const int, nanobind::shape<-1, 3>>;
    using Codes = Array<const std::uint8_t, nanobind::ndim<3>>;
    using CodesOut = Array<std::uint8_t, nanobind::ndim<3>>;

    static constexpr std::size_t kLongestSide = 1 << 15;

    antialias::Mesh mesh;
    antialias::Images images;

    // If `instanced` is true, each image has its own vertex positions; if it is false, all images share the same
    // positions. Every image of the batch has the same size.
    AntialiasArguments(const Colours& colours, const Rast& rast, const Positions& positions, const Triangles& triangles,
                       const std::optional<Triangles>& opposite, bool instanced) {
        require(colours.shape(1) >= 1 && colours.shape(1) <= kLongestSide && colours.shape(2) >= 1 &&
                    colours.shape(2) <= kLongestSide,
                "color: expected sides from 1 to 2^15 pixels");
        require(colours.shape(0) < 0x7fffffffu / kLongestSide, "color: expected fewer than 2^16 images");
        require(colours.shape(3) <= 0x7fffffffu / kLongestSide, "color: expected fewer than 2^16 channels");
        require(rast.shape(0) == colours.shape(0) && rast.shape(1) == colours.shape(1) &&
                    rast.shape(2) == colours.shape(2),
                "rast: expected the number, height and width of the images of color");
        require(positions.shape(0) == (instanced ? colours.shape(0) : 1), "pos: expected one instance for each image");
        require(positions.shape(1) <= 0x7fffffffu && positions.shape(0) * positions.shape(1) <= 0xffffffffu,
                "pos: expected fewer than 2^31 vertices, and fewer than 2^32 in all instances");
        require(triangles.shape(0) <= kMaxTriangles, "tri: too many triangles");
        require(!opposite || opposite->shape(0) == triangles.shape(0), "topology: expected one row per triangle of tri");
        mesh = {positions.data(),   triangles.data(),   opposite ? opposite->data() : nullptr,
                positions.shape(1), triangles.shape(0), instanced};
        images = {colours.data(),
                  rast.data(),
                  colours.shape(0),
                  static_cast<int>(colours.shape(1)),
                  static_cast<int>(colours.shape(2)),
                  static_cast<int>(colours.shape(3))};
    }

    void require_colours(std::size_t count, std::size_t height, std::size_t width, std::size_t channels,
                         const char* message) const {
        require(count == images.count && height == static_cast<std::size_t>(images.height) &&
                    width == static_cast<std::size_t>(images.width) &&
                    channels == static_cast<std::size_t>(images.channels),
                message);
    }

    template <typename Array>
    void require_like_colours(const Array& array, const char* message) const {
        require_colours(array.shape(0), array.shape(1), array.shape(2), array.shape(3), message);
    }

    template <typename Array>
    void require_codes(const Array& array) const {
        require_colours(array.shape(0), array.shape(1), array.shape(2), static_cast<std::size_t>(images.channels),
                        "codes: unexpected shape");
    }

    void require_like_positions(const PositionsOut& array) const {
        require(array.shape(0) == (mesh.instanced ? images.count : 1) && array.shape(1) == mesh.vertices,
                "out_pos: unexpected shape");
    }

    antialias::Gradients gradients(const Colours& gradient, const Codes& codes, float boost,
                                   const std::optional<ColoursOut>& out_colours,
                                   const std::optional<PositionsOut>& out_positions) const {
        require_like_colours(gradient, "gradient: unexpected shape");
        require_codes(codes);
        if (out_colours) require_like_colours(*out_colours, "out_color: unexpected shape");
        if (out_positions) require_like_positions(*out_positions);
        return {gradient.data(), codes.data(), boost, out_colours ? out_colours->data() : nullptr,
                out_positions ? out_positions->data() : nullptr};
    }
};

}  // namespace fourd
