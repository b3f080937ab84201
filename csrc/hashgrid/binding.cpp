// Python bindings of the hash grid; fourd/rendering/ops/hashgrid/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>

#include "hashgrid/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = HashGridArguments<nb::device::cpu>;
using RowsIn = Arguments::Rows<const float>;
using RowsOut = Arguments::Rows<float>;
using PointsIn = Arguments::Points<const float>;
using PointsOut = Arguments::Points<float>;

Arguments arguments_of(const PointsIn& coordinates, const RowsIn& table, const std::vector<int>& resolutions,
                       int log2_entries, int threads, const std::string& simd) {
    threads = clamp_threads(threads);
    return Arguments(coordinates, table, resolutions, log2_entries, threads, simd_named(simd.c_str()));
}

void encode(const PointsIn& coordinates, const RowsIn& table, const std::vector<int>& resolutions, int log2_entries,
            int threads, const std::string& simd, const RowsOut& out) {
    const Arguments arguments = arguments_of(coordinates, table, resolutions, log2_entries, threads, simd);
    arguments.require_rows(out, "out: unexpected shape");
    nb::gil_scoped_release release;
    hashgrid::encode(arguments.query, out.data());
}

void encode_backward(const PointsIn& coordinates, const RowsIn& table, const std::vector<int>& resolutions,
                     int log2_entries, int threads, const std::string& simd, const RowsIn& gradient,
                     const std::optional<RowsOut>& out_table, const std::optional<PointsOut>& out_coordinates) {
    const Arguments arguments = arguments_of(coordinates, table, resolutions, log2_entries, threads, simd);
    arguments.require_rows(gradient, "gradient: unexpected shape");
    float* const to_table = arguments.table_target(out_table);
    float* const to_coordinates = arguments.coordinates_target(out_coordinates);
    nb::gil_scoped_release release;
    hashgrid::encode_backward(arguments.query, gradient.data(), to_table, to_coordinates);
}

}  // namespace

void bind_hashgrid(nb::module_& module) {
    module.def("encode_hash_grid", &encode, nb::arg("coordinates"), nb::arg("table"), nb::arg("resolutions"),
               nb::arg("log2_entries"), nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               "Documented in fourd.rendering.ops.hashgrid.op.\n"
               "Sizes: resolutions*L coordinates=N log2_entries=3 table=8L,F out=N,LF");
    module.def("encode_hash_grid_backward", &encode_backward, nb::arg("coordinates"), nb::arg("table"),
               nb::arg("resolutions"), nb::arg("log2_entries"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("gradient"), nb::arg("out_table").none(), nb::arg("out_coordinates").none(),
               "Sizes: resolutions*L coordinates=N log2_entries=3 table=8L,F gradient=N,LF out_table=8L,F "
               "out_coordinates=N");
}

}  // namespace fourd
