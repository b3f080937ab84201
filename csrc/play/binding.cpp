// Python bindings for drawing baked frames and for sorting their points by depth. fourd/rendering/ops/play/op.py documents the
// operations.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <string>
#include <vector>

#include "play/arguments.h"
#include "play/play.h"
#include "points/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = FrameArguments<nb::device::cpu, std::uint16_t>;
using Picture = nb::ndarray<std::uint8_t, nb::shape<-1, -1, 4>, nb::c_contig, nb::device::cpu>;

void draw(play::Player& player, const Arguments::Xyz& xyz, const Arguments::Column& radius,
          const Arguments::Column& density, const Arguments::Harmonics& sh, const Arguments::Weights& weights,
          const Arguments::Colours& rgb, const ChosenArray& chosen, const ViewWeightArray& view_weights,
          const CentreArray& centre, float sh_range, float sh_base, const std::vector<double>& camera, int layers,
          double near_depth, double transmittance_min, const std::array<float, 3>& background, float pixel_filter,
          int threads, const std::string& simd, const Picture& out) {
    require(pixel_filter >= 0.0f && pixel_filter <= 0.25f, "pixel_filter: expected a weight from 0 to 0.25");
    const play::Frame frame = Arguments::frame(xyz, radius, density, sh, weights, rgb);
    const shade::Settings shading =
        shade_settings(chosen, view_weights, frame.points.views, centre, sh_range, sh_base, threads, simd);
    const points::Settings settings =
        points_settings(camera, out.shape(1), out.shape(0), layers, near_depth, transmittance_min, threads, simd);
    nb::gil_scoped_release release;
    player.draw(frame, settings, shading, {out.data(), {background[0], background[1], background[2]}}, pixel_filter);
}

using Octahedral = nb::ndarray<const std::uint8_t, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Depths = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void draw_surface(play::Player& player, const Arguments::Xyz& xyz, const Arguments::Column& radius,
                  const Arguments::Column& density, const Arguments::Harmonics& sh, const Arguments::Weights& weights,
                  const Arguments::Colours& rgb, const Octahedral& normals, const ChosenArray& chosen,
                  const ViewWeightArray& view_weights, const CentreArray& centre, float sh_range, float sh_base,
                  const std::vector<double>& camera, int layers, double near_depth, double transmittance_min,
                  float persistence, int threads, const std::string& simd, const Picture& albedo,
                  const Depths& inverse_depth, const Picture& normal) {
    play::Frame frame = Arguments::frame(xyz, radius, density, sh, weights, rgb);
    require(normals.shape(0) == frame.points.count, "normals: expected as many normals as points");
    require(persistence >= 0.0f && persistence < 1.0f, "persistence: expected a number from 0 to below 1");
    for (int side = 0; side < 2; ++side) {
        require(inverse_depth.shape(side) == albedo.shape(side) && normal.shape(side) == albedo.shape(side),
                "inverse_depth, normal: expected the size of albedo");
    }
    frame.normals = normals.data();
    const shade::Settings shading =
        shade_settings(chosen, view_weights, frame.points.views, centre, sh_range, sh_base, threads, simd);
    const points::Settings settings =
        points_settings(camera, albedo.shape(1), albedo.shape(0), layers, near_depth, transmittance_min, threads, simd);
    nb::gil_scoped_release release;
    player.draw_surface(
        frame, settings, shading,
        {{albedo.data(), {0.0f, 0.0f, 0.0f}}, inverse_depth.data(), normal.data(), persistence});
}

using Indices = nb::ndarray<std::uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

std::size_t sort(play::DepthSorter& sorter, const Arguments::Xyz& xyz, const Arguments::Column& radius,
                 const Arguments::Column& density, const std::vector<double>& camera, std::size_t width,
                 std::size_t height, double near_depth, int threads, const std::string& simd, const Indices& out) {
    const play::Frame frame = Arguments::bare_frame(xyz, radius, density);
    require(out.shape(0) == frame.points.count, "out: expected as many indices as points");
    const points::Settings settings = points_settings(camera, width, height, 1, near_depth, 0.0, threads, simd);
    nb::gil_scoped_release release;
    return sorter.sort(frame, settings, out.data());
}

}  // namespace

void bind_play(nb::module_& module) {
    nb::class_<play::Player> player(module, "Player", "Draws baked frames. Threads must not share an instance.");
    player.def(nb::init<>())
        .def("draw", &draw, nb::arg("xyz"), nb::arg("radius"), nb::arg("density"), nb::arg("sh"),
             nb::arg("blend_weights"), nb::arg("rgb"), nb::arg("chosen"), nb::arg("view_weights"), nb::arg("centre"),
             nb::arg("sh_range"), nb::arg("sh_base"), nb::arg("camera"), nb::arg("layers"), nb::arg("near"),
             nb::arg("transmittance_min"), nb::arg("background"), nb::arg("pixel_filter"), nb::arg("threads"),
             nb::arg("simd"), nb::arg("out"),
             "Sizes: xyz=N radius=N density=N sh=N blend_weights=N,V rgb=N,V chosen=K chosen<V view_weights=K "
             "camera*21 background*3 out=H,W");
    player.def("draw_surface", &draw_surface, nb::arg("xyz"), nb::arg("radius"), nb::arg("density"), nb::arg("sh"),
               nb::arg("blend_weights"), nb::arg("rgb"), nb::arg("normals"), nb::arg("chosen"),
               nb::arg("view_weights"), nb::arg("centre"), nb::arg("sh_range"), nb::arg("sh_base"), nb::arg("camera"),
               nb::arg("layers"), nb::arg("near"), nb::arg("transmittance_min"), nb::arg("persistence"),
               nb::arg("threads"), nb::arg("simd"), nb::arg("albedo"), nb::arg("inverse_depth"), nb::arg("normal"),
               "Sizes: xyz=N radius=N density=N sh=N blend_weights=N,V rgb=N,V normals=N chosen=K chosen<V "
               "view_weights=K camera*21 albedo=H,W inverse_depth=H,W normal=H,W");
    nb::class_<play::DepthSorter>(module, "DepthSorter", "Sorts points by depth. Threads must not share an instance.")
        .def(nb::init<>())
        .def("sort", &sort, nb::arg("xyz"), nb::arg("radius"), nb::arg("density"), nb::arg("camera"), nb::arg("width"),
             nb::arg("height"), nb::arg("near"), nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
             "Sizes: xyz=N radius=N density=N camera*21 width=W height=H out=N");
}

}  // namespace fourd
