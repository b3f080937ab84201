// Python bindings of K-Planes on a GPU; fourd/rendering/ops/planes/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "binding/cuda_arrays.h"
#include "planes/arguments.h"
#include "planes/cuda/sample.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = PlaneArguments<Where>;

Arguments arguments_of(const Arguments::Coordinates& coordinates, const std::vector<Arguments::Values>& values,
                       const std::vector<int>& axes) {
    require(values.size() <= planes::cuda::kMaxPlanes, "planes: expected at most 64 on a GPU");
    return Arguments(coordinates, values, axes, 1, Simd::baseline);
}

void sample(const Arguments::Coordinates& coordinates, const std::vector<Arguments::Values>& values,
            const std::vector<int>& axes, std::uintptr_t stream, const Arguments::RowsOut& out) {
    const Arguments arguments = arguments_of(coordinates, values, axes);
    arguments.require_rows(out, "out: unexpected shape");
    planes::cuda::sample(arguments.query, out.data(), stream_of(stream));
}

void sample_backward(const Arguments::Coordinates& coordinates, const std::vector<Arguments::Values>& values,
                     const std::vector<int>& axes, std::uintptr_t stream, const Arguments::Rows& gradient,
                     const std::vector<Arguments::ValuesOut>& out_planes,
                     const std::optional<Arguments::CoordinatesOut>& out_coordinates) {
    const Arguments arguments = arguments_of(coordinates, values, axes);
    arguments.require_rows(gradient, "gradient: unexpected shape");
    const std::vector<float*> targets = arguments.targets(out_planes);
    planes::cuda::sample_backward(arguments.query, gradient.data(), targets.data(), arguments.target(out_coordinates),
                                  stream_of(stream));
}

}  // namespace

void bind_planes(nb::module_& module) {
    module.def("sample_planes", &sample, nb::arg("coordinates"), nb::arg("planes"), nb::arg("axes"), nb::arg("stream"),
               nb::arg("out"));
    module.def("sample_planes_backward", &sample_backward, nb::arg("coordinates"), nb::arg("planes"), nb::arg("axes"),
               nb::arg("stream"), nb::arg("gradient"), nb::arg("out_planes"), nb::arg("out_coordinates").none());
}

}  // namespace fourd::cuda
