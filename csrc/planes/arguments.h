// Converts the arguments of the K-Planes kernels for the CPU and a GPU. fourd/rendering/ops/planes/op.py checks the values of the
// arguments. This file checks the shapes of arrays, because a kernel would read past the end of an array that is too
// small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>
#include <vector>

#include "binding/require.h"
#include "planes/planes.h"

namespace fourd {

template <typename Device>
struct PlaneArguments {
    template <typename Number, std::size_t Axes>
    using Array = nanobind::ndarray<Number, nanobind::ndim<Axes>, nanobind::c_contig, Device>;
    using Values = Array<const float, 3>;
    using ValuesOut = Array<float, 3>;
    using Coordinates = nanobind::ndarray<const float, nanobind::shape<-1, 4>, nanobind::c_contig, Device>;
    using CoordinatesOut = nanobind::ndarray<float, nanobind::shape<-1, 4>, nanobind::c_contig, Device>;
    using Rows = Array<const float, 2>;
    using RowsOut = Array<float, 2>;

    static constexpr std::size_t kLongestSide = 1 << 24;  // Indices below 2^24 are exact in float32.

    const std::vector<Values>& values;
    std::vector<planes::Plane> planes;
    planes::Query query;

    // For each plane, `axes` has the indices (0 to 3) of two coordinates: first the coordinate that selects the column,
    // then the coordinate that selects the row.
    PlaneArguments(const Coordinates& coordinates, const std::vector<Values>& values_, const std::vector<int>& axes,
                   int threads, Simd simd)
        : values(values_) {
        require(!values.empty() && axes.size() == 2 * values.size(), "axes: expected two for each plane");
        for (std::size_t k = 0; k < values.size(); ++k) {
            const std::size_t rows = values[k].shape(0), columns = values[k].shape(1);
            require(rows >= 2 && columns >= 2 && rows <= kLongestSide && columns <= kLongestSide,
                    "planes: expected sides from 2 to 2^24");
            require(features() >= 1 && features() <= planes::kMaxFeatures && values[k].shape(2) == features(),
                    "planes: expected 1 to 64 features, the same in all");
            require(axes[2 * k] >= 0 && axes[2 * k] < 4 && axes[2 * k + 1] >= 0 && axes[2 * k + 1] < 4,
                    "axes: expected 0 to 3");
            planes.push_back(
                {values[k].data(), static_cast<int>(columns), static_cast<int>(rows), axes[2 * k], axes[2 * k + 1]});
        }
        require(coordinates.shape(0) < 0xffffffffu, "coordinates: expected fewer than 2^32 points");
        query = {planes.data(),
                 static_cast<int>(planes.size()),
                 static_cast<int>(features()),
                 coordinates.data(),
                 coordinates.shape(0),
                 threads,
                 simd};
    }

    std::size_t features() const { return values[0].shape(2); }

    // Checks that the array `rows` has the shape (points, planes x features).
    template <typename Array>
    void require_rows(const Array& rows, const char* message) const {
        require(rows.shape(0) == query.count && rows.shape(1) == planes.size() * features(), message);
    }

    std::vector<float*> targets(const std::vector<ValuesOut>& out_planes) const {
        require(out_planes.size() == planes.size(), "out_planes: expected one for each plane");
        std::vector<float*> out;
        for (std::size_t k = 0; k < planes.size(); ++k) {
            for (std::size_t axis = 0; axis < 3; ++axis) {
                require(out_planes[k].shape(axis) == values[k].shape(axis), "out_planes: expected the planes' shapes");
            }
            out.push_back(out_planes[k].data());
        }
        return out;
    }

    float* target(const std::optional<CoordinatesOut>& out_coordinates) const {
        require(!out_coordinates || out_coordinates->shape(0) == query.count, "out_coordinates: unexpected shape");
        return out_coordinates ? out_coordinates->data() : nullptr;
    }
};

}  // namespace fourd
