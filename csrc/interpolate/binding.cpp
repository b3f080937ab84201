// Python bindings of the interpolation; fourd/rendering/ops/interpolate/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <string>

#include "interpolate/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = InterpolateArguments<nb::device::cpu>;
using AttributesIn = Arguments::Attributes<const float>;
using AttributesOut = Arguments::Attributes<float>;
using ImageIn = Arguments::Image<const float>;
using ImageOut = Arguments::Image<float>;

void interpolate_attributes(const AttributesIn& attr, const ImageIn& rast, const Arguments::Triangles& tri,
                            const std::optional<ImageIn>& rast_db, const Arguments::Channels& diff, int threads,
                            const std::string& simd, const ImageOut& out, const ImageOut& out_da) {
    const Arguments arguments(attr, rast, tri, rast_db, diff, clamp_threads(threads), simd_named(simd.c_str()));
    float* const to = arguments.image(out, arguments.query.channels, "out: unexpected shape");
    float* const to_da = arguments.image(out_da, 2 * arguments.query.diff_count, "out_da: unexpected shape");
    nb::gil_scoped_release release;
    interpolate::interpolate(arguments.query, to, to_da);
}

void interpolate_attributes_backward(const AttributesIn& attr, const ImageIn& rast, const Arguments::Triangles& tri,
                                     const std::optional<ImageIn>& rast_db, const Arguments::Channels& diff,
                                     int threads, const std::string& simd, const ImageIn& grad_out,
                                     const ImageIn& grad_da, const std::optional<AttributesOut>& grad_attr,
                                     const std::optional<ImageOut>& grad_rast,
                                     const std::optional<ImageOut>& grad_db) {
    const Arguments arguments(attr, rast, tri, rast_db, diff, clamp_threads(threads), simd_named(simd.c_str()));
    const interpolate::Query& query = arguments.query;
    const interpolate::Gradients gradients{
        arguments.image(grad_out, query.channels, "grad_out: unexpected shape"),
        arguments.image(grad_da, 2 * query.diff_count, "grad_da: unexpected shape"), arguments.attributes(grad_attr),
        arguments.image(grad_rast, 4, "grad_rast: unexpected shape"),
        arguments.image(grad_db, 4, "grad_db: unexpected shape")};
    nb::gil_scoped_release release;
    interpolate::interpolate_backward(query, gradients);
}

}  // namespace

void bind_interpolate(nb::module_& module) {
    module.def("interpolate_attributes", &interpolate_attributes, nb::arg("attr"), nb::arg("rast"), nb::arg("tri"),
               nb::arg("rast_db").none(), nb::arg("diff"), nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               nb::arg("out_da"),
               "Documented in fourd.rendering.ops.interpolate.op.\n"
               "Sizes: attr=1,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C out=B,H,W,C "
               "out_da=B,H,W,2D\n"
               "Sizes: attr=B,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C out=B,H,W,C "
               "out_da=B,H,W,2D");
    module.def("interpolate_attributes_backward", &interpolate_attributes_backward, nb::arg("attr"), nb::arg("rast"),
               nb::arg("tri"), nb::arg("rast_db").none(), nb::arg("diff"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("grad_out"), nb::arg("grad_da"), nb::arg("grad_attr").none(), nb::arg("grad_rast").none(),
               nb::arg("grad_db").none(),
               "Sizes: attr=1,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C grad_out=B,H,W,C "
               "grad_da=B,H,W,2D grad_attr=1,V,C grad_rast=B,H,W,4 grad_db=B,H,W,4\n"
               "Sizes: attr=B,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C grad_out=B,H,W,C "
               "grad_da=B,H,W,2D grad_attr=B,V,C grad_rast=B,H,W,4 grad_db=B,H,W,4");
}

}  // namespace fourd
