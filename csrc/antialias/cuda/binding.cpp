// Python bindings of antialiasing on a GPU; fourd/rendering/ops/antialias/op.py documents the operations.
#include <nanobind/stl/optional.h>

#include "antialias/arguments.h"
#include "antialias/cuda/antialias.h"
#include "binding/cuda_arrays.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = AntialiasArguments<Where>;

std::size_t workspace_bytes(std::size_t triangles, std::size_t images, bool instanced) {
    antialias::Mesh mesh{};
    mesh.triangle_count = triangles;
    mesh.instanced = instanced;
    return antialias::cuda::workspace_bytes(mesh, images);
}

void blend(const Arguments::Colours& colours, const Arguments::Rast& rast, const Arguments::Positions& positions,
           const Arguments::Triangles& triangles, const Arguments::Triangles& opposite, bool instanced,
           const Workspace& workspace, std::uintptr_t stream, const Arguments::ColoursOut& out,
           const Arguments::CodesOut& codes) {
    const Arguments arguments(colours, rast, positions, triangles, opposite, instanced);
    arguments.require_like_colours(out, "out: unexpected shape");
    arguments.require_codes(codes);
    require(workspace.shape(0) >= antialias::cuda::workspace_bytes(arguments.mesh, arguments.images.count),
            "workspace: expected more bytes");
    antialias::cuda::blend(arguments.mesh, arguments.images, workspace.data(), out.data(), codes.data(),
                           stream_of(stream));
}

void blend_backward(const Arguments::Colours& colours, const Arguments::Rast& rast,
                    const Arguments::Positions& positions, const Arguments::Triangles& triangles, bool instanced,
                    std::uintptr_t stream, const Arguments::Colours& gradient, const Arguments::Codes& codes,
                    float boost, const std::optional<Arguments::ColoursOut>& out_colours,
                    const std::optional<Arguments::PositionsOut>& out_positions) {
    const Arguments arguments(colours, rast, positions, triangles, std::nullopt, instanced);
    antialias::cuda::blend_backward(arguments.mesh, arguments.images,
                                    arguments.gradients(gradient, codes, boost, out_colours, out_positions),
                                    stream_of(stream));
}

}  // namespace

void bind_antialias(nb::module_& module) {
    module.def("antialias_workspace_bytes", &workspace_bytes, nb::arg("triangles"), nb::arg("images"),
               nb::arg("instanced"));
    module.def("antialias", &blend, nb::arg("color"), nb::arg("rast"), nb::arg("pos"), nb::arg("tri"),
               nb::arg("opposite"), nb::arg("instanced"), nb::arg("workspace"), nb::arg("stream"), nb::arg("out"),
               nb::arg("codes"));
    module.def("antialias_backward", &blend_backward, nb::arg("color"), nb::arg("rast"), nb::arg("pos"), nb::arg("tri"),
               nb::arg("instanced"), nb::arg("stream"), nb::arg("gradient"), nb::arg("codes"), nb::arg("boost"),
               nb::arg("out_color").none(), nb::arg("out_pos").none());
}

}  // namespace fourd::cuda
