// Python bindings that compute the gradients of moving visibility edges on a GPU; fourd/rendering/ops/edge_gradients/op.py
// documents the operation.
#include <nanobind/stl/optional.h>

#include "antialias/arguments.h"
#include "binding/cuda_arrays.h"
#include "edge_gradients/cuda/edge_gradients.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = AntialiasArguments<Where>;

std::size_t workspace_bytes(std::size_t triangles, std::size_t images, bool instanced) {
    antialias::Mesh mesh{};
    mesh.triangle_count = triangles;
    mesh.instanced = instanced;
    return edge_gradients::cuda::workspace_bytes(mesh, images);
}

void compute(const Arguments::Colours& colours, const Arguments::Rast& rast, const Arguments::Positions& positions,
             const Arguments::Triangles& triangles, const Arguments::Triangles& opposite, bool instanced,
             const Workspace& workspace, std::uintptr_t stream, const Arguments::Colours& gradient,
             const Arguments::PositionsOut& out) {
    const Arguments arguments(colours, rast, positions, triangles, opposite, instanced);
    arguments.require_like_colours(gradient, "gradient: unexpected shape");
    arguments.require_like_positions(out);
    require(workspace.shape(0) >= edge_gradients::cuda::workspace_bytes(arguments.mesh, arguments.images.count),
            "workspace: expected more bytes");
    edge_gradients::cuda::edge_gradients(arguments.mesh, arguments.images, workspace.data(), gradient.data(),
                                         out.data(), stream_of(stream));
}

}  // namespace

void bind_edge_gradients(nb::module_& module) {
    module.def("edge_gradients_workspace_bytes", &workspace_bytes, nb::arg("triangles"), nb::arg("images"),
               nb::arg("instanced"));
    module.def("edge_gradients", &compute, nb::arg("color"), nb::arg("rast"), nb::arg("pos"), nb::arg("tri"),
               nb::arg("opposite"), nb::arg("instanced"), nb::arg("workspace"), nb::arg("stream"), nb::arg("gradient"),
               nb::arg("out_pos"));
}

}  // namespace fourd::cuda
