// Python bindings of the point renderer on a GPU; fourd/rendering/ops/points/cuda.py passes the memory and the CUDA stream.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <utility>
#include <vector>

#include "binding/cuda_arrays.h"
#include "points/cuda/entry_arguments.h"
#include "points/arguments.h"
#include "points/cuda/render.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = PointArguments<Where>;

points::Settings make_settings(const std::vector<double>& camera, std::size_t width, std::size_t height, int layers,
                               double near_depth, double transmittance_min) {
    return points_settings(camera, width, height, layers, near_depth, transmittance_min, 1, "");
}

points::cuda::EntryBuffer checked_buffer(const EntryBufferArguments& buffer, const points::Cloud& cloud,
                                         const points::Pinhole& camera) {
    return buffer.checked(
        points::cuda::workspace_bytes(cloud.count, cloud.channels, camera.width, camera.height, buffer.entries));
}

// Returns the number of (point, tile) entries to allocate, and the size of the workspace in bytes.
std::pair<std::size_t, std::size_t> plan(device::EntryEstimator& estimator, std::size_t count, int channels, int width,
                                         int height) {
    const std::size_t entries = estimator.entries(count);
    return {entries, points::cuda::workspace_bytes(count, channels, width, height, entries)};
}

void render(const Arguments::Xyz& xyz, const Arguments::Rows& features, const Arguments::Column& radius,
            const Arguments::Column& density, const std::vector<double>& camera, int layers, double near_depth,
            double transmittance_min, const device::EntryEstimator& estimator, std::size_t entries,
            const Workspace& workspace, std::uintptr_t stream, const Arguments::PictureOut& out_features,
            const Arguments::RowsOut& out_alpha, const Arguments::RowsOut& out_depth) {
    const points::Cloud cloud = Arguments::cloud(xyz, features, radius, density);
    const points::Image image = Arguments::image(cloud, out_features, out_alpha, out_depth);
    const points::Settings settings =
        make_settings(camera, out_alpha.shape(1), out_alpha.shape(0), layers, near_depth, transmittance_min);
    points::cuda::render(cloud, settings, checked_buffer({estimator, entries, workspace}, cloud, settings.camera),
                         image, stream_of(stream));
}

void render_backward(const Arguments::Xyz& xyz, const Arguments::Rows& features, const Arguments::Column& radius,
                     const Arguments::Column& density, const std::vector<double>& camera, int layers, double near_depth,
                     const device::EntryEstimator& estimator, std::size_t entries, const Workspace& workspace,
                     std::uintptr_t stream, const Arguments::Picture& grad_features, const Arguments::Rows& grad_alpha,
                     const std::optional<Arguments::Rows>& grad_depth, const Arguments::XyzOut& out_xyz,
                     const Arguments::RowsOut& out_features, const Arguments::ColumnOut& out_radius,
                     const Arguments::ColumnOut& out_density) {
    const points::Cloud cloud = Arguments::cloud(xyz, features, radius, density);
    const points::ImageGradient gradient = Arguments::image_gradient(cloud, grad_features, grad_alpha, grad_depth);
    const points::CloudGradient out = Arguments::cloud_gradient(cloud, out_xyz, out_features, out_radius, out_density);
    require(layers <= points::cuda::kMaxLayersBackward, "layers: expected at most 64 where gradients are required");
    const points::Settings settings =
        make_settings(camera, grad_alpha.shape(1), grad_alpha.shape(0), layers, near_depth, 0.0);
    points::cuda::render_backward(cloud, settings,
                                  checked_buffer({estimator, entries, workspace}, cloud, settings.camera), gradient,
                                  out, stream_of(stream));
}

void visibility(const Arguments::Xyz& xyz, const Arguments::Column& radius, const Arguments::Column& density,
                const std::vector<double>& camera, std::size_t width, std::size_t height, int layers, double near_depth,
                const device::EntryEstimator& estimator, std::size_t entries, const Workspace& workspace,
                std::uintptr_t stream, const Arguments::ColumnOut& out) {
    const points::Cloud cloud = Arguments::bare_cloud(xyz, radius, density);
    require(out.shape(0) == cloud.count, "out: unexpected shape");
    const points::Settings settings = make_settings(camera, width, height, layers, near_depth, 0.0);
    points::cuda::visibility(cloud, settings, checked_buffer({estimator, entries, workspace}, cloud, settings.camera),
                             out.data(), stream_of(stream));
}

}  // namespace

void bind_points(nb::module_& module) {
    module.def("plan_points", &plan, nb::arg("estimator"), nb::arg("count"), nb::arg("channels"), nb::arg("width"),
               nb::arg("height"),
               "Returns the number of entries to allocate for the next image, and the size of the workspace in bytes.");
    module.def("render_points", &render, nb::arg("xyz"), nb::arg("features"), nb::arg("radius"), nb::arg("density"),
               nb::arg("camera"), nb::arg("layers"), nb::arg("near"), nb::arg("transmittance_min"),
               nb::arg("estimator"), nb::arg("entries"), nb::arg("workspace"), nb::arg("stream"),
               nb::arg("out_features"), nb::arg("out_alpha"), nb::arg("out_depth"));
    module.def("render_points_backward", &render_backward, nb::arg("xyz"), nb::arg("features"), nb::arg("radius"),
               nb::arg("density"), nb::arg("camera"), nb::arg("layers"), nb::arg("near"), nb::arg("estimator"),
               nb::arg("entries"), nb::arg("workspace"), nb::arg("stream"), nb::arg("grad_features"),
               nb::arg("grad_alpha"), nb::arg("grad_depth").none(), nb::arg("out_xyz"), nb::arg("out_features"),
               nb::arg("out_radius"), nb::arg("out_density"));
    module.def("point_visibility", &visibility, nb::arg("xyz"), nb::arg("radius"), nb::arg("density"),
               nb::arg("camera"), nb::arg("width"), nb::arg("height"), nb::arg("layers"), nb::arg("near"),
               nb::arg("estimator"), nb::arg("entries"), nb::arg("workspace"), nb::arg("stream"), nb::arg("out"));
}

}  // namespace fourd::cuda
