// Python bindings of the hash grid on a GPU; fourd/rendering/ops/hashgrid/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "binding/cuda_arrays.h"
#include "hashgrid/arguments.h"
#include "hashgrid/cuda/encode.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = HashGridArguments<Where>;
using RowsIn = Arguments::Rows<const float>;
using RowsOut = Arguments::Rows<float>;
using PointsIn = Arguments::Points<const float>;
using PointsOut = Arguments::Points<float>;

Arguments arguments_of(const PointsIn& coordinates, const RowsIn& table, const std::vector<int>& resolutions,
                       int log2_entries) {
    return Arguments(coordinates, table, resolutions, log2_entries, 1, Simd::baseline);
}

void encode(const PointsIn& coordinates, const RowsIn& table, const std::vector<int>& resolutions, int log2_entries,
            std::uintptr_t stream, const RowsOut& out) {
    const Arguments arguments = arguments_of(coordinates, table, resolutions, log2_entries);
    arguments.require_rows(out, "out: unexpected shape");
    hashgrid::cuda::encode(arguments.query, out.data(), stream_of(stream));
}

void encode_backward(const PointsIn& coordinates, const RowsIn& table, const std::vector<int>& resolutions,
                     int log2_entries, std::uintptr_t stream, const RowsIn& gradient,
                     const std::optional<RowsOut>& out_table, const std::optional<PointsOut>& out_coordinates) {
    const Arguments arguments = arguments_of(coordinates, table, resolutions, log2_entries);
    arguments.require_rows(gradient, "gradient: unexpected shape");
    hashgrid::cuda::encode_backward(arguments.query, gradient.data(), arguments.table_target(out_table),
                                    arguments.coordinates_target(out_coordinates), stream_of(stream));
}

}  // namespace

void bind_hashgrid(nb::module_& module) {
    module.def("encode_hash_grid", &encode, nb::arg("coordinates"), nb::arg("table"), nb::arg("resolutions"),
               nb::arg("log2_entries"), nb::arg("stream"), nb::arg("out"));
    module.def("encode_hash_grid_backward", &encode_backward, nb::arg("coordinates"), nb::arg("table"),
               nb::arg("resolutions"), nb::arg("log2_entries"), nb::arg("stream"), nb::arg("gradient"),
               nb::arg("out_table").none(), nb::arg("out_coordinates").none());
}

}  // namespace fourd::cuda
