// Python bindings that draw baked frames on a GPU. fourd/rendering/ops/play/cuda.py documents the operations.
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <utility>
#include <vector>

#include "binding/cuda_arrays.h"
#include "play/arguments.h"
#include "play/cuda/draw.h"
#include "points/arguments.h"
#include "points/cuda/entry_arguments.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

// torch passes float16 arrays as int16.
using Arguments = FrameArguments<Where, std::int16_t>;
using Picture = Array<std::uint8_t, nb::shape<-1, -1, 4>>;
using ColourOut = Array<float, nb::shape<-1, 3>>;

std::pair<std::size_t, std::size_t> plan(device::EntryEstimator& estimator, std::size_t count, int width, int height) {
    const std::size_t entries = estimator.entries(count);
    return {entries, play::cuda::workspace_bytes(count, width, height, entries)};
}

void draw(const Arguments::Xyz& xyz, const Arguments::Column& radius, const Arguments::Column& density,
          const Arguments::Harmonics& sh, const Arguments::Weights& weights, const Arguments::Colours& rgb,
          const ChosenArray& chosen, const ViewWeightArray& view_weights, const CentreArray& centre, float sh_range,
          float sh_base, const std::vector<double>& camera, int layers, double near_depth, double transmittance_min,
          const std::array<float, 3>& background, const device::EntryEstimator& estimator, std::size_t entries,
          const Workspace& workspace, std::uintptr_t stream, const Picture& out) {
    const play::Frame frame = Arguments::frame(xyz, radius, density, sh, weights, rgb);
    const shade::Settings shading =
        shade_settings(chosen, view_weights, frame.points.views, centre, sh_range, sh_base, 1, "");
    const points::Settings settings =
        points_settings(camera, out.shape(1), out.shape(0), layers, near_depth, transmittance_min, 1, "");
    const EntryBufferArguments buffer{estimator, entries, workspace};
    const std::size_t bytes =
        play::cuda::workspace_bytes(frame.points.count, settings.camera.width, settings.camera.height, entries);
    play::cuda::draw(frame, settings, shading, buffer.checked(bytes),
                     {out.data(), {background[0], background[1], background[2]}}, stream_of(stream));
}

void shade(const Arguments::Xyz& xyz, const Arguments::Harmonics& sh, const Arguments::Weights& weights,
           const Arguments::Colours& rgb, const ChosenArray& chosen, const ViewWeightArray& view_weights,
           const CentreArray& centre, float sh_range, float sh_base, std::uintptr_t stream, const ColourOut& out) {
    const shade::Points points = Arguments::points(xyz, sh, weights, rgb);
    require(out.shape(0) == points.count, "out: unexpected shape");
    const shade::Settings shading =
        shade_settings(chosen, view_weights, points.views, centre, sh_range, sh_base, 1, "");
    play::cuda::shade(points, shading, out.data(), stream_of(stream));
}

}  // namespace

void bind_play(nb::module_& module) {
    module.def("plan_draw", &plan, nb::arg("estimator"), nb::arg("count"), nb::arg("width"), nb::arg("height"),
               "The number of entries to allocate, and the bytes of workspace, for the next image.");
    module.def("draw", &draw, nb::arg("xyz"), nb::arg("radius"), nb::arg("density"), nb::arg("sh"),
               nb::arg("blend_weights"), nb::arg("rgb"), nb::arg("chosen"), nb::arg("view_weights"), nb::arg("centre"),
               nb::arg("sh_range"), nb::arg("sh_base"), nb::arg("camera"), nb::arg("layers"), nb::arg("near"),
               nb::arg("transmittance_min"), nb::arg("background"), nb::arg("estimator"), nb::arg("entries"),
               nb::arg("workspace"), nb::arg("stream"), nb::arg("out"));
    module.def("shade", &shade, nb::arg("xyz"), nb::arg("sh"), nb::arg("blend_weights"), nb::arg("rgb"),
               nb::arg("chosen"), nb::arg("view_weights"), nb::arg("centre"), nb::arg("sh_range"), nb::arg("sh_base"),
               nb::arg("stream"), nb::arg("out"));
}

}  // namespace fourd::cuda
