// Python binding that computes the gradients of moving visibility edges; fourd/rendering/ops/edge_gradients/op.py documents the
// operation.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <string>

#include "antialias/arguments.h"
#include "edge_gradients/edge_gradients.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = AntialiasArguments<nb::device::cpu>;

void compute(const Arguments::Colours& colours, const Arguments::Rast& rast, const Arguments::Positions& positions,
             const Arguments::Triangles& triangles, const Arguments::Triangles& opposite, bool instanced, int threads,
             const std::string& simd, const Arguments::Colours& gradient, const Arguments::PositionsOut& out) {
    const Arguments arguments(colours, rast, positions, triangles, opposite, instanced);
    arguments.require_like_colours(gradient, "gradient: unexpected shape");
    arguments.require_like_positions(out);
    const antialias::Settings settings{clamp_threads(threads), simd_named(simd.c_str())};
    nb::gil_scoped_release release;
    edge_gradients::edge_gradients(arguments.mesh, arguments.images, settings, gradient.data(), out.data());
}

}  // namespace

void bind_edge_gradients(nb::module_& module) {
    module.def("edge_gradients", &compute, nb::arg("color"), nb::arg("rast"), nb::arg("pos"), nb::arg("tri"),
               nb::arg("opposite"), nb::arg("instanced"), nb::arg("threads"), nb::arg("simd"), nb::arg("gradient"),
               nb::arg("out_pos"),
               "Documented in fourd.rendering.ops.edge_gradients.op.\n"
               "Sizes: color=B,H,W,C rast=B,H,W pos=1,V tri=T tri<V opposite=T opposite<V gradient=B,H,W,C "
               "out_pos=1,V\n"
               "Sizes: color=B,H,W,C rast=B,H,W pos=B,V tri=T tri<V opposite=T opposite<V gradient=B,H,W,C "
               "out_pos=B,V");
}

}  // namespace fourd
