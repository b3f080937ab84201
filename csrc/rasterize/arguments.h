// Checks and converts the arguments of the rasterizer, for the CPU and a GPU. fourd/rendering/ops/rasterize/op.py checks the
// values of the arguments. This file checks the shapes of arrays, because a kernel would read past the end of an array
// that is too small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>

#include "binding/require.h"
#include "common/triangle_id.h"
#include "rasterize/rasterize.h"

namespace fourd {

template <typename Device>
struct RasterizeArguments {
    template <typename Number>
    using Positions = nanobind::ndarray<Number, nanobind::shape<-1, -1, 4>, nanobind::c_contig, Device>;
    template <typename Number>
    using Image = nanobind::ndarray<Number, nanobind::shape<-1, -1, -1, 4>, nanobind::c_contig, Device>;
    using Triangles = nanobind::ndarray<const std::int32_t, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using Ranges = nanobind::ndarray<const std::int32_t, nanobind::shape<-1, 2>, nanobind::c_contig, Device>;

    rasterize::Query query;

    // If `ranges` is given, all images share the same vertex positions. Otherwise, `pos` has separate positions for
    // each image of `rast`.
    RasterizeArguments(const Positions<const float>& pos, const Triangles& tri, const std::optional<Ranges>& ranges,
                       std::size_t images, std::size_t height, std::size_t width, int threads, Simd simd) {
        require(height >= 1 && height <= rasterize::kLongestSide && width >= 1 && width <= rasterize::kLongestSide,
                "rast: expected sides from 1 to 32768 pixels");
        const std::size_t tiles = images * ((height + 31) / 32) * ((width + 31) / 32);
        require(tiles <= 0x7fffffff, "rast: expected at most 2^31 - 1 tiles of 32 x 32 pixels");
        require(tri.shape(0) <= kMaxTriangles, "tri: too many triangles");
        require(pos.shape(1) <= 0x7fffffff, "pos: expected at most 2^31 - 1 vertices");
        require(ranges ? pos.shape(0) == 1 && ranges->shape(0) == images : pos.shape(0) == images,
                "pos: expected one mesh with ranges of all images, or a mesh for each image");
        query = {pos.data(),
                 pos.shape(1),
                 ranges ? 0 : pos.shape(1),
                 tri.data(),
                 tri.shape(0),
                 ranges ? ranges->data() : nullptr,
                 static_cast<int>(images),
                 static_cast<int>(height),
                 static_cast<int>(width),
                 threads,
                 simd};
    }

    template <typename Number>
    Number* image(const Image<Number>& array, const char* message) const {
        require(array.shape(0) == static_cast<std::size_t>(query.images) &&
                    array.shape(1) == static_cast<std::size_t>(query.height) &&
                    array.shape(2) == static_cast<std::size_t>(query.width),
                message);
        return array.data();
    }

    template <typename Number>
    Number* image(const std::optional<Image<Number>>& array, const char* message) const {
        return array ? image(*array, message) : nullptr;
    }
};

}  // namespace fourd
