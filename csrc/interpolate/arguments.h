// Checks and converts the arguments of the interpolation, for the CPU and a GPU. fourd/rendering/ops/interpolate/op.py checks the
// values of the arguments. This file checks the shapes of arrays, because a kernel would read past the end of an array
// that is too small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>

#include "binding/indices.h"
#include "interpolate/interpolate.h"

namespace fourd {

template <typename Device>
struct InterpolateArguments {
    template <typename Number>
    using Attributes = nanobind::ndarray<Number, nanobind::ndim<3>, nanobind::c_contig, Device>;
    template <typename Number>
    using Image = nanobind::ndarray<Number, nanobind::ndim<4>, nanobind::c_contig, Device>;
    using Triangles = nanobind::ndarray<const std::int32_t, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using Channels = nanobind::ndarray<const std::int32_t, nanobind::ndim<1>, nanobind::c_contig, Device>;

    interpolate::Query query;

    // `diff` has channel indices, each below the number of channels. If the arrays are on a GPU, only op.py checks
    // these indices.
    InterpolateArguments(const Attributes<const float>& attr, const Image<const float>& rast, const Triangles& tri,
                         const std::optional<Image<const float>>& rast_db, const Channels& diff, int threads,
                         Simd simd) {
        query = {attr.data(),
                 attr.shape(1),
                 attr.shape(2),
                 attr.shape(0) == 1 ? 0 : attr.shape(1),
                 tri.data(),
                 tri.shape(0),
                 rast.data(),
                 rast_db ? rast_db->data() : nullptr,
                 static_cast<int>(rast.shape(0)),
                 static_cast<int>(rast.shape(1)),
                 static_cast<int>(rast.shape(2)),
                 diff.data(),
                 diff.shape(0),
                 threads,
                 simd};
        const std::size_t limit = 1 << 15, tiles = (rast.shape(1) / 32 + 1) * (rast.shape(2) / 32 + 1);
        require(rast.shape(1) >= 1 && rast.shape(1) <= limit && rast.shape(2) >= 1 && rast.shape(2) <= limit,
                "rast: expected sides from 1 to 32768 pixels");
        require(rast.shape(0) <= 0x7fffffff && tiles * rast.shape(0) <= 0x7fffffff,
                "rast: expected at most 2^31 - 1 tiles of 32 x 32 pixels");
        require(attr.shape(0) == 1 || attr.shape(0) == rast.shape(0), "attr: expected one mesh, or one for each image");
        require(attr.shape(2) >= 1, "attr: expected at least 1 channel");
        require(diff.shape(0) == 0 || rast_db, "rast_db: expected derivatives if diff is not empty");
        require_indices(diff, attr.shape(2), "diff: expected indices of channels");
        image(rast, 4, "rast: unexpected shape");
        if (rast_db) image(*rast_db, 4, "rast_db: unexpected shape");
    }

    template <typename Number>
    Number* image(const Image<Number>& array, std::size_t channels, const char* message) const {
        require(array.shape(0) == static_cast<std::size_t>(query.images) &&
                    array.shape(1) == static_cast<std::size_t>(query.height) &&
                    array.shape(2) == static_cast<std::size_t>(query.width) && array.shape(3) == channels,
                message);
        return array.data();
    }

    template <typename Number>
    Number* image(const std::optional<Image<Number>>& array, std::size_t channels, const char* message) const {
        return array ? image(*array, channels, message) : nullptr;
    }

    float* attributes(const std::optional<Attributes<float>>& array) const {
        if (!array) return nullptr;
        const std::size_t copies = query.image_stride == 0 ? 1 : static_cast<std::size_t>(query.images);
        require(array->shape(0) == copies && array->shape(1) == query.vertices && array->shape(2) == query.channels,
                "grad_attr: unexpected shape");
        return array->data();
    }
};

}  // namespace fourd
