// Python bindings of the decoder of packed scenes; fourd/rendering/ops/unpack/op.py documents the operations.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <string>
#include <vector>

#include "binding/require.h"
#include "unpack/unpack.h"

namespace nb = nanobind;

namespace fourd {
namespace {

template <typename Number, std::size_t Axes>
using Array = nb::ndarray<Number, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;
using Bytes = Array<const std::uint8_t, 1>;

void unpack_harmonics(const Bytes& content, const Array<const float, 2>& basis, const Array<const float, 1>& mean,
                      const std::string& simd, const Array<std::uint16_t, 2>& out) {
    const std::size_t points = out.shape(0), rows = basis.shape(0);
    require(out.shape(1) == unpack::kShNumbers && mean.shape(0) == unpack::kShNumbers, "out, mean: expected 48 numbers");
    require(rows <= unpack::kShNumbers && (rows == 0 || basis.shape(1) == unpack::kShNumbers),
            "basis: expected shape (K, 48) with K up to 48");
    require(content.shape(0) == 2 * rows * points, "content: expected two bytes for each point and row");
    const unpack::Harmonics from{content.data(), content.data() + rows * points, rows, points, basis.data(),
                                 mean.data()};
    const unpack::Loops& loops = unpack::select_loops(simd_named(simd.c_str()));
    nb::gil_scoped_release release;
    loops.harmonics(from, out.data());
}

void unpack_positions(const Bytes& content, const Array<const double, 1>& lower, double step,
                      const Array<float, 2>& out) {
    const std::size_t points = out.shape(0);
    require(lower.shape(0) == 3 && out.shape(1) == 3, "lower, out: expected three coordinates");
    const std::size_t bytes = points == 0 ? 1 : content.shape(0) / points;
    require(bytes >= 1 && bytes <= 8 && content.shape(0) == bytes * points,
            "content: expected 1 to 8 bytes for each point");
    nb::gil_scoped_release release;
    unpack::positions({content.data(), static_cast<int>(bytes), points, lower.data(), step}, out.data());
}

unpack::View view_of(const Bytes& content, std::size_t points, bool every_point_has_colours) {
    require(content.shape(0) >= points, "contents: expected a weight code for each point");
    const std::size_t none = static_cast<std::size_t>(std::count(content.data(), content.data() + points, 0));
    const std::size_t colours = every_point_has_colours ? points : points - none;
    require(content.shape(0) == points + 3 * colours, "contents: expected three bytes for each point with a colour");
    return {content.data(), content.data() + points, colours};
}

void unpack_views(const std::vector<Bytes>& contents, const Array<const std::uint8_t, 2>& mean,
                  const Array<const std::uint16_t, 1>& weights, int colour_step, bool every_point_has_colours,
                  const std::string& simd, const Array<std::uint16_t, 2>& out_weights,
                  const Array<std::uint8_t, 3>& out_rgb) {
    const std::size_t points = mean.shape(0), count = contents.size();
    require(mean.shape(1) == 3, "mean: expected shape (N, 3)");
    require(weights.shape(0) == unpack::kWeightCodes, "weights: expected 256 values");
    require(colour_step >= 1 && colour_step <= 127, "colour_step: expected a whole number from 1 to 127");
    require(out_weights.shape(0) == points && out_weights.shape(1) == count, "out_weights: unexpected shape");
    require(out_rgb.shape(0) == points && out_rgb.shape(1) == count && out_rgb.shape(2) == 3,
            "out_rgb: unexpected shape");
    std::vector<unpack::View> views;
    for (const Bytes& content : contents) views.push_back(view_of(content, points, every_point_has_colours));
    std::vector<std::size_t> next(count);
    const unpack::Views from{views.data(),   count,       points,
                             mean.data(),    weights.data(), colour_step, every_point_has_colours};
    const unpack::Loops& loops = unpack::select_loops(simd_named(simd.c_str()));
    nb::gil_scoped_release release;
    loops.views(from, next.data(), out_weights.data(), out_rgb.data());
}

}  // namespace

void bind_unpack(nb::module_& module) {
    module.def("unpack_harmonics", &unpack_harmonics, nb::arg("content"), nb::arg("basis"), nb::arg("mean"),
               nb::arg("simd"), nb::arg("out"),
               "Documented in fourd.rendering.ops.unpack.op.\n"
               "Sizes: content=2RN basis=R,48 mean=48 out=N,48");
    module.def("unpack_positions", &unpack_positions, nb::arg("content"), nb::arg("lower"), nb::arg("step"),
               nb::arg("out"),
               "Documented in fourd.rendering.ops.unpack.op.\n"
               "Sizes: content=BN lower=3 out=N,3");
    module.def("unpack_views", &unpack_views, nb::arg("contents"), nb::arg("mean"), nb::arg("weights"),
               nb::arg("colour_step"), nb::arg("every_point_has_colours"), nb::arg("simd"), nb::arg("out_weights"),
               nb::arg("out_rgb"),
               "Sizes: contents*V=N+3N mean=N,3 weights=256 out_weights=N,V out_rgb=N,V");
}

}  // namespace fourd
