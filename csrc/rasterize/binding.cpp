// Python bindings of the rasterizer; fourd/rendering/ops/rasterize/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <string>

#include "rasterize/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = RasterizeArguments<nb::device::cpu>;
using PositionsIn = Arguments::Positions<const float>;
using PositionsOut = Arguments::Positions<float>;
using ImageIn = Arguments::Image<const float>;
using ImageOut = Arguments::Image<float>;

void rasterize_triangles(const PositionsIn& pos, const Arguments::Triangles& tri,
                         const std::optional<Arguments::Ranges>& ranges, const std::optional<ImageIn>& previous,
                         int threads, const std::string& simd, const ImageOut& rast,
                         const std::optional<ImageOut>& rast_db) {
    const Arguments arguments(pos, tri, ranges, rast.shape(0), rast.shape(1), rast.shape(2), clamp_threads(threads),
                              simd_named(simd.c_str()));
    const float* const before = arguments.image(previous, "previous: unexpected shape");
    float* const to_db = arguments.image(rast_db, "rast_db: unexpected shape");
    nb::gil_scoped_release release;
    rasterize::rasterize(arguments.query, before, rast.data(), to_db);
}

void rasterize_triangles_backward(const PositionsIn& pos, const Arguments::Triangles& tri,
                                  const std::optional<Arguments::Ranges>& ranges, const ImageIn& rast, int threads,
                                  const std::string& simd, const ImageIn& grad_rast,
                                  const std::optional<ImageIn>& grad_db, const PositionsOut& grad_pos) {
    const Arguments arguments(pos, tri, ranges, rast.shape(0), rast.shape(1), rast.shape(2), clamp_threads(threads),
                              simd_named(simd.c_str()));
    const float* const gradient = arguments.image(grad_rast, "grad_rast: unexpected shape");
    const float* const gradient_db = arguments.image(grad_db, "grad_db: unexpected shape");
    require(grad_pos.shape(0) == pos.shape(0) && grad_pos.shape(1) == pos.shape(1), "grad_pos: unexpected shape");
    nb::gil_scoped_release release;
    rasterize::rasterize_backward(arguments.query, rast.data(), gradient, gradient_db, grad_pos.data());
}

}  // namespace

void bind_rasterize(nb::module_& module) {
    module.def("rasterize_triangles", &rasterize_triangles, nb::arg("pos"), nb::arg("tri"), nb::arg("ranges").none(),
               nb::arg("previous").none(), nb::arg("threads"), nb::arg("simd"), nb::arg("rast"),
               nb::arg("rast_db").none(),
               "Documented in fourd.rendering.ops.rasterize.op.\n"
               "Sizes: pos=1,V tri=T tri<V ranges=B ranges<T previous=B,H,W rast=B,H,W rast_db=B,H,W\n"
               "Sizes: pos=B,V tri=T tri<V previous=B,H,W rast=B,H,W rast_db=B,H,W");
    module.def("rasterize_triangles_backward", &rasterize_triangles_backward, nb::arg("pos"), nb::arg("tri"),
               nb::arg("ranges").none(), nb::arg("rast"), nb::arg("threads"), nb::arg("simd"), nb::arg("grad_rast"),
               nb::arg("grad_db").none(), nb::arg("grad_pos"),
               "Sizes: pos=1,V tri=T tri<V ranges=B ranges<T rast=B,H,W grad_rast=B,H,W grad_db=B,H,W grad_pos=1,V\n"
               "Sizes: pos=B,V tri=T tri<V rast=B,H,W grad_rast=B,H,W grad_db=B,H,W grad_pos=B,V");
}

}  // namespace fourd
