// Python bindings of the rasterizer on a GPU; fourd/rendering/ops/rasterize/op.py documents the operations.
#include <nanobind/stl/optional.h>

#include "binding/cuda_arrays.h"
#include "rasterize/arguments.h"
#include "rasterize/cuda/rasterize.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = RasterizeArguments<Where>;
using PositionsIn = Arguments::Positions<const float>;
using PositionsOut = Arguments::Positions<float>;
using ImageIn = Arguments::Image<const float>;
using ImageOut = Arguments::Image<float>;

void rasterize_triangles(const PositionsIn& pos, const Arguments::Triangles& tri,
                         const std::optional<Arguments::Ranges>& ranges, const std::optional<ImageIn>& previous,
                         std::size_t longest_range, const Workspace& workspace, std::uintptr_t stream,
                         const ImageOut& rast, const std::optional<ImageOut>& rast_db) {
    const Arguments arguments(pos, tri, ranges, rast.shape(0), rast.shape(1), rast.shape(2), 1, Simd::baseline);
    const float* const before = arguments.image(previous, "previous: unexpected shape");
    float* const to_db = arguments.image(rast_db, "rast_db: unexpected shape");
    require(longest_range <= tri.shape(0), "longest_range: expected at most the number of triangles");
    require(workspace.size() >= rasterize::cuda::workspace_bytes(rast.shape(0), rast.shape(1), rast.shape(2),
                                                                 longest_range),
            "workspace: expected the bytes of rasterize_workspace_bytes");
    rasterize::cuda::rasterize(arguments.query, longest_range, workspace.data(), before, rast.data(), to_db,
                               stream_of(stream));
}

void rasterize_triangles_backward(const PositionsIn& pos, const Arguments::Triangles& tri,
                                  const std::optional<Arguments::Ranges>& ranges, const ImageIn& rast,
                                  std::uintptr_t stream, const ImageIn& grad_rast,
                                  const std::optional<ImageIn>& grad_db, const PositionsOut& grad_pos) {
    const Arguments arguments(pos, tri, ranges, rast.shape(0), rast.shape(1), rast.shape(2), 1, Simd::baseline);
    const float* const gradient = arguments.image(grad_rast, "grad_rast: unexpected shape");
    const float* const gradient_db = arguments.image(grad_db, "grad_db: unexpected shape");
    require(grad_pos.shape(0) == pos.shape(0) && grad_pos.shape(1) == pos.shape(1), "grad_pos: unexpected shape");
    rasterize::cuda::rasterize_backward(arguments.query, rast.data(), gradient, gradient_db, grad_pos.data(),
                                        stream_of(stream));
}

}  // namespace

void bind_rasterize(nb::module_& module) {
    module.def("rasterize_workspace_bytes", &rasterize::cuda::workspace_bytes, nb::arg("images"), nb::arg("height"),
               nb::arg("width"), nb::arg("longest_range"));
    module.def("rasterize_triangles", &rasterize_triangles, nb::arg("pos"), nb::arg("tri"), nb::arg("ranges").none(),
               nb::arg("previous").none(), nb::arg("longest_range"), nb::arg("workspace"), nb::arg("stream"),
               nb::arg("rast"), nb::arg("rast_db").none());
    module.def("rasterize_triangles_backward", &rasterize_triangles_backward, nb::arg("pos"), nb::arg("tri"),
               nb::arg("ranges").none(), nb::arg("rast"), nb::arg("stream"), nb::arg("grad_rast"),
               nb::arg("grad_db").none(), nb::arg("grad_pos"));
}

}  // namespace fourd::cuda
