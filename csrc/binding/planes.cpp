// K-Planes' Python face: fourd/model/plane_lookup.py checks values, shapes are checked here, since a wrong
// one would read past an array.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "binding/bindings.h"
#include "binding/convert.h"
#include "planes/planes.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using PlaneValues = nb::ndarray<const float, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using PlaneOut = nb::ndarray<float, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Coordinates = nb::ndarray<const float, nb::numpy, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;
using CoordinatesOut = nb::ndarray<float, nb::numpy, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;
using Rows = nb::ndarray<const float, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using RowsOut = nb::ndarray<float, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

constexpr std::size_t kLongestSide = 1 << 24;  // above it float32 does not tell samples apart

// axes: two coordinates a plane, along its columns and down its rows.
std::vector<planes::Plane> planes_of(const std::vector<PlaneValues>& values, const std::vector<int>& axes) {
    require(!values.empty() && axes.size() == 2 * values.size(), "axes: expected two for each plane");
    std::vector<planes::Plane> out;
    for (std::size_t k = 0; k < values.size(); ++k) {
        const std::size_t rows = values[k].shape(0), columns = values[k].shape(1), features = values[k].shape(2);
        require(rows >= 2 && columns >= 2 && rows <= kLongestSide && columns <= kLongestSide,
                "planes: expected sides from 2 to 2^24");
        require(features >= 1 && features <= planes::kMostFeatures && features == values[0].shape(2),
                "planes: expected 1 to 64 features, the same in all");
        require(axes[2 * k] >= 0 && axes[2 * k] < 4 && axes[2 * k + 1] >= 0 && axes[2 * k + 1] < 4,
                "axes: expected 0 to 3");
        out.push_back({values[k].data(), static_cast<int>(columns), static_cast<int>(rows), axes[2 * k],
                       axes[2 * k + 1]});
    }
    return out;
}

planes::Query query_of(const std::vector<planes::Plane>& planes, std::size_t features, const Coordinates& coordinates,
                       int threads, const std::string& simd) {
    require(coordinates.shape(0) < 0xffffffffu, "coordinates: expected fewer than 2^32 points");
    return {planes.data(), static_cast<int>(planes.size()), static_cast<int>(features), coordinates.data(),
            coordinates.shape(0), std::clamp(threads, 1, 256), simd_named(simd.c_str())};
}

void sample_planes(const Coordinates& coordinates, const std::vector<PlaneValues>& values,
                   const std::vector<int>& axes, int threads, const std::string& simd, const RowsOut& out) {
    const std::vector<planes::Plane> found = planes_of(values, axes);
    const planes::Query query = query_of(found, values[0].shape(2), coordinates, threads, simd);
    require(out.shape(0) == query.count && out.shape(1) == found.size() * values[0].shape(2), "out: unexpected shape");
    nb::gil_scoped_release release;
    planes::sample(query, out.data());
}

void sample_planes_backward(const Coordinates& coordinates, const std::vector<PlaneValues>& values,
                            const std::vector<int>& axes, int threads, const std::string& simd, const Rows& gradient,
                            const std::vector<PlaneOut>& out_planes,
                            const std::optional<CoordinatesOut>& out_coordinates) {
    const std::vector<planes::Plane> found = planes_of(values, axes);
    const planes::Query query = query_of(found, values[0].shape(2), coordinates, threads, simd);
    require(gradient.shape(0) == query.count && gradient.shape(1) == found.size() * values[0].shape(2),
            "gradient: unexpected shape");
    require(out_planes.size() == found.size(), "out_planes: expected one for each plane");
    std::vector<float*> targets;
    for (std::size_t k = 0; k < found.size(); ++k) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
            require(out_planes[k].shape(axis) == values[k].shape(axis), "out_planes: expected the planes' shapes");
        }
        targets.push_back(out_planes[k].data());
    }
    require(!out_coordinates || out_coordinates->shape(0) == query.count, "out_coordinates: unexpected shape");
    float* const grad_coordinates = out_coordinates ? out_coordinates->data() : nullptr;
    nb::gil_scoped_release release;
    planes::sample_backward(query, gradient.data(), targets.data(), grad_coordinates);
}

}  // namespace

void bind_planes(nb::module_& module) {
    module.def("sample_planes", &sample_planes, nb::arg("coordinates"), nb::arg("planes"), nb::arg("axes"),
               nb::arg("threads"), nb::arg("simd"), nb::arg("out"), "See fourd.model.plane_lookup for what it computes.");
    module.def("sample_planes_backward", &sample_planes_backward, nb::arg("coordinates"), nb::arg("planes"),
               nb::arg("axes"), nb::arg("threads"), nb::arg("simd"), nb::arg("gradient"), nb::arg("out_planes"),
               nb::arg("out_coordinates").none());
}

}  // namespace fourd
