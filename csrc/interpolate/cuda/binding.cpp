// Python bindings of the interpolation on a GPU; fourd/rendering/ops/interpolate/op.py documents the operations.
#include <nanobind/stl/optional.h>

#include "binding/cuda_arrays.h"
#include "interpolate/arguments.h"
#include "interpolate/cuda/interpolate.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = InterpolateArguments<Where>;
using AttributesIn = Arguments::Attributes<const float>;
using AttributesOut = Arguments::Attributes<float>;
using ImageIn = Arguments::Image<const float>;
using ImageOut = Arguments::Image<float>;

void interpolate_attributes(const AttributesIn& attr, const ImageIn& rast, const Arguments::Triangles& tri,
                            const std::optional<ImageIn>& rast_db, const Arguments::Channels& diff,
                            std::uintptr_t stream, const ImageOut& out, const ImageOut& out_da) {
    const Arguments arguments(attr, rast, tri, rast_db, diff, 1, Simd::baseline);
    float* const to = arguments.image(out, arguments.query.channels, "out: unexpected shape");
    float* const to_da = arguments.image(out_da, 2 * arguments.query.diff_count, "out_da: unexpected shape");
    interpolate::cuda::interpolate(arguments.query, to, to_da, stream_of(stream));
}

void interpolate_attributes_backward(const AttributesIn& attr, const ImageIn& rast, const Arguments::Triangles& tri,
                                     const std::optional<ImageIn>& rast_db, const Arguments::Channels& diff,
                                     std::uintptr_t stream, const ImageIn& grad_out, const ImageIn& grad_da,
                                     const std::optional<AttributesOut>& grad_attr,
                                     const std::optional<ImageOut>& grad_rast,
                                     const std::optional<ImageOut>& grad_db) {
    const Arguments arguments(attr, rast, tri, rast_db, diff, 1, Simd::baseline);
    const interpolate::Query& query = arguments.query;
    const interpolate::Gradients gradients{
        arguments.image(grad_out, query.channels, "grad_out: unexpected shape"),
        arguments.image(grad_da, 2 * query.diff_count, "grad_da: unexpected shape"), arguments.attributes(grad_attr),
        arguments.image(grad_rast, 4, "grad_rast: unexpected shape"),
        arguments.image(grad_db, 4, "grad_db: unexpected shape")};
    interpolate::cuda::interpolate_backward(query, gradients, stream_of(stream));
}

}  // namespace

void bind_interpolate(nb::module_& module) {
    module.def("interpolate_attributes", &interpolate_attributes, nb::arg("attr"), nb::arg("rast"), nb::arg("tri"),
               nb::arg("rast_db").none(), nb::arg("diff"), nb::arg("stream"), nb::arg("out"), nb::arg("out_da"));
    module.def("interpolate_attributes_backward", &interpolate_attributes_backward, nb::arg("attr"), nb::arg("rast"),
               nb::arg("tri"), nb::arg("rast_db").none(), nb::arg("diff"), nb::arg("stream"), nb::arg("grad_out"),
               nb::arg("grad_da"), nb::arg("grad_attr").none(), nb::arg("grad_rast").none(),
               nb::arg("grad_db").none());
}

}  // namespace fourd::cuda
