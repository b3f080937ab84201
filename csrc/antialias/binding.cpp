// Python bindings of antialiasing; fourd/rendering/ops/antialias/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <string>

#include "antialias/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = AntialiasArguments<nb::device::cpu>;

antialias::Settings settings_of(int threads, const std::string& simd) {
    return {clamp_threads(threads), simd_named(simd.c_str())};
}

void blend(const Arguments::Colours& colours, const Arguments::Rast& rast, const Arguments::Positions& positions,
           const Arguments::Triangles& triangles, const Arguments::Triangles& opposite, bool instanced, int threads,
           const std::string& simd, const Arguments::ColoursOut& out, const Arguments::CodesOut& codes) {
    const Arguments arguments(colours, rast, positions, triangles, opposite, instanced);
    arguments.require_like_colours(out, "out: unexpected shape");
    arguments.require_codes(codes);
    const antialias::Settings settings = settings_of(threads, simd);
    nb::gil_scoped_release release;
    antialias::blend(arguments.mesh, arguments.images, settings, out.data(), codes.data());
}

void blend_backward(const Arguments::Colours& colours, const Arguments::Rast& rast,
                    const Arguments::Positions& positions, const Arguments::Triangles& triangles, bool instanced,
                    int threads, const std::string& simd, const Arguments::Colours& gradient,
                    const Arguments::Codes& codes, float boost, const std::optional<Arguments::ColoursOut>& out_colours,
                    const std::optional<Arguments::PositionsOut>& out_positions) {
    const Arguments arguments(colours, rast, positions, triangles, std::nullopt, instanced);
    const antialias::Gradients gradients = arguments.gradients(gradient, codes, boost, out_colours, out_positions);
    const antialias::Settings settings = settings_of(threads, simd);
    nb::gil_scoped_release release;
    antialias::blend_backward(arguments.mesh, arguments.images, settings, gradients);
}

}  // namespace

void bind_antialias(nb::module_& module) {
    module.def("antialias", &blend, nb::arg("color"), nb::arg("rast"), nb::arg("pos"), nb::arg("tri"),
               nb::arg("opposite"), nb::arg("instanced"), nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               nb::arg("codes"),
               "Documented in fourd.rendering.ops.antialias.op.\n"
               "Sizes: color=B,H,W,C rast=B,H,W pos=1,V tri=T tri<V opposite=T opposite<V out=B,H,W,C codes=B,H,W\n"
               "Sizes: color=B,H,W,C rast=B,H,W pos=B,V tri=T tri<V opposite=T opposite<V out=B,H,W,C codes=B,H,W");
    module.def("antialias_backward", &blend_backward, nb::arg("color"), nb::arg("rast"), nb::arg("pos"), nb::arg("tri"),
               nb::arg("instanced"), nb::arg("threads"), nb::arg("simd"), nb::arg("gradient"), nb::arg("codes"),
               nb::arg("boost"), nb::arg("out_color").none(), nb::arg("out_pos").none(),
               "Sizes: color=B,H,W,C rast=B,H,W pos=1,V tri=T tri<V gradient=B,H,W,C codes=B,H,W out_color=B,H,W,C "
               "out_pos=1,V\n"
               "Sizes: color=B,H,W,C rast=B,H,W pos=B,V tri=T tri<V gradient=B,H,W,C codes=B,H,W out_color=B,H,W,C "
               "out_pos=B,V");
}

}  // namespace fourd
