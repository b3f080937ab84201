// Python bindings of the stylizer. fourd/rendering/ops/stylize/op.py documents the operation.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <cmath>
#include <cstring>
#include <optional>
#include <string>

#include "binding/require.h"
#include "stylize/stylize.h"

namespace nb = nanobind;

namespace fourd {
namespace {

template <typename Number>
using Picture = nb::ndarray<Number, nb::shape<-1, -1, 4>, nb::c_contig, nb::device::cpu>;
template <typename Number>
using Plane = nb::ndarray<Number, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using NumberArray = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Table = nb::ndarray<const std::uint32_t, nb::shape<-1, stylize::kTones>, nb::c_contig, nb::device::cpu>;

stylize::Style style_of(const NumberArray& numbers, int detail, int lines, int thickness, const Table& table) {
    constexpr std::size_t kCount = sizeof(stylize::Numbers) / sizeof(float);
    require(numbers.shape(0) == kCount, "numbers: expected as many numbers as the struct Numbers has");
    for (std::size_t i = 0; i < kCount; ++i) require(std::isfinite(numbers.data()[i]), "numbers: expected finite numbers");
    require(detail >= 0 && detail <= 2, "detail: expected 0, 1 or 2");
    require(lines >= 0 && lines <= 2, "lines: expected 0, 1 or 2");
    require(thickness >= 1 && thickness <= stylize::kMaxThickness, "thickness: expected 1 to 8 pixels");
    require(table.shape(0) >= 1 && table.shape(0) <= stylize::kMaxRows, "table: expected 1 to 64 rows");
    stylize::Style style{{},
                         static_cast<stylize::Detail>(detail),
                         static_cast<stylize::Lines>(lines),
                         thickness,
                         table.data(),
                         static_cast<int>(table.shape(0))};
    std::memcpy(&style.numbers, numbers.data(), sizeof style.numbers);
    require(style.numbers.depth_threshold > 0.0f && style.numbers.normal_threshold > 0.0f,
            "depth_threshold, normal_threshold: expected more than 0");
    require(style.numbers.hysteresis >= 0.0f && style.numbers.hysteresis < 1.0f && style.numbers.persistence >= 0.0f &&
                style.numbers.persistence < 1.0f,
            "hysteresis, persistence: expected numbers from 0 to below 1");
    require(style.numbers.angle_softness > 0.0f, "angle_softness: expected more than 0");
    require(style.numbers.hatch_spacing >= 1.0f, "hatch_spacing: expected at least 1 pixel");
    return style;
}

void run(const Picture<const std::uint8_t>& albedo, const Plane<const float>& inverse_depth,
         const Picture<const std::uint8_t>& normal, const NumberArray& numbers, int detail, int lines, int thickness,
         const Table& table, int threads, const std::string& simd, const std::optional<Plane<std::uint32_t>>& line_state,
         const Picture<std::uint8_t>& out) {
    for (int side = 0; side < 2; ++side) {
        const std::size_t size = albedo.shape(side);
        require(size <= (1 << 18), "albedo: expected at most 262144 pixels per side");
        require(inverse_depth.shape(side) == size && normal.shape(side) == size && out.shape(side) == size &&
                    (!line_state || line_state->shape(side) == size),
                "inverse_depth, normal, line_state, out: expected the size of albedo");
    }
    const stylize::Style style = style_of(numbers, detail, lines, thickness, table);
    const stylize::Surface surface{albedo.data(), inverse_depth.data(), normal.data(),
                                   static_cast<int>(albedo.shape(1)), static_cast<int>(albedo.shape(0))};
    nb::gil_scoped_release release;
    stylize::stylize(surface, style, clamp_threads(threads), simd_named(simd.c_str()),
                     line_state ? line_state->data() : nullptr, out.data());
}

}  // namespace

void bind_stylize(nb::module_& module) {
    module.def("stylize", &run, nb::arg("albedo"), nb::arg("inverse_depth"), nb::arg("normal"), nb::arg("numbers"),
               nb::arg("detail"), nb::arg("lines"), nb::arg("thickness"), nb::arg("table"), nb::arg("threads"),
               nb::arg("simd"), nb::arg("line_state").none(), nb::arg("out"),
               "Sizes: albedo=H,W inverse_depth=H,W normal=H,W numbers=38 table=R line_state=H,W out=H,W");
}

}  // namespace fourd
