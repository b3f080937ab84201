// Python bindings of K-Planes; fourd/rendering/ops/planes/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>

#include "planes/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = PlaneArguments<nb::device::cpu>;

Arguments arguments_of(const Arguments::Coordinates& coordinates, const std::vector<Arguments::Values>& values,
                       const std::vector<int>& axes, int threads, const std::string& simd) {
    return Arguments(coordinates, values, axes, clamp_threads(threads), simd_named(simd.c_str()));
}

void sample_planes(const Arguments::Coordinates& coordinates, const std::vector<Arguments::Values>& values,
                   const std::vector<int>& axes, int threads, const std::string& simd, const Arguments::RowsOut& out) {
    const Arguments arguments = arguments_of(coordinates, values, axes, threads, simd);
    arguments.require_rows(out, "out: unexpected shape");
    nb::gil_scoped_release release;
    planes::sample(arguments.query, out.data());
}

void sample_planes_backward(const Arguments::Coordinates& coordinates, const std::vector<Arguments::Values>& values,
                            const std::vector<int>& axes, int threads, const std::string& simd,
                            const Arguments::Rows& gradient, const std::vector<Arguments::ValuesOut>& out_planes,
                            const std::optional<Arguments::CoordinatesOut>& out_coordinates) {
    const Arguments arguments = arguments_of(coordinates, values, axes, threads, simd);
    arguments.require_rows(gradient, "gradient: unexpected shape");
    const std::vector<float*> targets = arguments.targets(out_planes);
    float* const target = arguments.target(out_coordinates);
    nb::gil_scoped_release release;
    planes::sample_backward(arguments.query, gradient.data(), targets.data(), target);
}

}  // namespace

void bind_planes(nb::module_& module) {
    module.def("sample_planes", &sample_planes, nb::arg("coordinates"), nb::arg("planes"), nb::arg("axes"),
               nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               "Documented in fourd.rendering.ops.planes.op.\n"
               "Sizes: coordinates=N planes*P=H,W,F axes*2P out=N,PF");
    module.def("sample_planes_backward", &sample_planes_backward, nb::arg("coordinates"), nb::arg("planes"),
               nb::arg("axes"), nb::arg("threads"), nb::arg("simd"), nb::arg("gradient"), nb::arg("out_planes"),
               nb::arg("out_coordinates").none(),
               "Sizes: coordinates=N planes*P=H,W,F axes*2P gradient=N,PF out_planes*P=H,W,F out_coordinates=N");
}

}  // namespace fourd
