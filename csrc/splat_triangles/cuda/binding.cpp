// Python bindings of triangle splatting on a GPU; fourd/rendering/ops/splat_triangles/cuda.py passes the memory and the CUDA
// stream.
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <utility>
#include <vector>

#include "binding/cuda_arrays.h"
#include "points/cuda/entry_arguments.h"
#include "splat_triangles/arguments.h"
#include "splat_triangles/cuda/render.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = SplatArguments<Where>;

tiles::cuda::EntryBuffer checked_buffer(const EntryBufferArguments& buffer, const splat_triangles::Mesh& mesh,
                                        const tiles::Pinhole& camera) {
    return buffer.checked(splat_triangles::cuda::workspace_bytes(mesh.count, mesh.channels, camera.width,
                                                                 camera.height, buffer.entries));
}

// Returns the number of (triangle, tile) entries to allocate, and the size of the workspace in bytes.
std::pair<std::size_t, std::size_t> plan(device::EntryEstimator& estimator, std::size_t count, int channels, int width,
                                         int height) {
    const std::size_t entries = estimator.entries(count);
    return {entries, splat_triangles::cuda::workspace_bytes(count, channels, width, height, entries)};
}

void render(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
            const Arguments::Column& opacity, const Arguments::Column& sigma, bool geometry,
            const std::vector<double>& camera, int layers, double near_depth, const device::EntryEstimator& estimator,
            std::size_t entries, const Workspace& workspace, std::uintptr_t stream,
            const Arguments::PictureOut& out_features, const Arguments::RowsOut& out_alpha,
            const Arguments::RowsOut& out_transmittance, const Arguments::PictureOut& out_normal,
            const Arguments::RowsOut& out_depth, const Arguments::ColumnOut& out_weight) {
    const splat_triangles::Mesh mesh = Arguments::mesh(xyz, tri, features, opacity, sigma, geometry);
    const splat_triangles::Image image =
        Arguments::image(mesh, out_features, out_alpha, out_transmittance, out_normal, out_depth);
    require(out_weight.shape(0) == mesh.count, "out_weight: unexpected shape");
    const splat_triangles::Settings settings =
        splat_settings(camera, out_alpha.shape(1), out_alpha.shape(0), layers, near_depth, 1, "");
    splat_triangles::cuda::render(mesh, settings,
                                  checked_buffer({estimator, entries, workspace}, mesh, settings.camera), image,
                                  out_weight.data(), stream_of(stream));
}

void render_backward(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
                     const Arguments::Column& opacity, const Arguments::Column& sigma, bool geometry,
                     const std::vector<double>& camera, int layers, double near_depth,
                     const device::EntryEstimator& estimator, std::size_t entries, const Workspace& workspace,
                     std::uintptr_t stream, const Arguments::PictureOut& rendered_features,
                     const Arguments::RowsOut& rendered_alpha, const Arguments::RowsOut& rendered_transmittance,
                     const Arguments::PictureOut& rendered_normal, const Arguments::RowsOut& rendered_depth,
                     const Arguments::Picture& grad_features, const Arguments::Rows& grad_alpha,
                     const Arguments::Picture& grad_normal, const Arguments::Rows& grad_depth,
                     const Arguments::XyzOut& out_xyz, const Arguments::RowsOut& out_features,
                     const Arguments::ColumnOut& out_opacity, const Arguments::ColumnOut& out_sigma) {
    const splat_triangles::Mesh mesh = Arguments::mesh(xyz, tri, features, opacity, sigma, geometry);
    const splat_triangles::Image rendered = Arguments::image(mesh, rendered_features, rendered_alpha,
                                                             rendered_transmittance, rendered_normal, rendered_depth);
    const splat_triangles::ImageGradient gradient =
        Arguments::gradient(mesh, grad_features, grad_alpha, grad_normal, grad_depth, rendered);
    require(grad_alpha.shape(0) == rendered_alpha.shape(0) && grad_alpha.shape(1) == rendered_alpha.shape(1),
            "grad_alpha: unexpected shape");
    const splat_triangles::MeshGradient out =
        Arguments::mesh_gradient(mesh, out_xyz, out_features, out_opacity, out_sigma);
    const splat_triangles::Settings settings =
        splat_settings(camera, grad_alpha.shape(1), grad_alpha.shape(0), layers, near_depth, 1, "");
    splat_triangles::cuda::render_backward(mesh, settings,
                                           checked_buffer({estimator, entries, workspace}, mesh, settings.camera),
                                           gradient, out, stream_of(stream));
}

}  // namespace

void bind_splat_triangles(nb::module_& module) {
    module.def("plan_splats", &plan, nb::arg("estimator"), nb::arg("count"), nb::arg("channels"), nb::arg("width"),
               nb::arg("height"),
               "The number of entries to allocate, and the bytes of workspace, for the next image.");
    module.def("splat_triangles", &render, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"), nb::arg("opacity"),
               nb::arg("sigma"), nb::arg("geometry"), nb::arg("camera"), nb::arg("layers"), nb::arg("near"),
               nb::arg("estimator"), nb::arg("entries"), nb::arg("workspace"), nb::arg("stream"),
               nb::arg("out_features"), nb::arg("out_alpha"), nb::arg("out_transmittance"), nb::arg("out_normal"),
               nb::arg("out_depth"), nb::arg("out_weight"));
    module.def("splat_triangles_backward", &render_backward, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"),
               nb::arg("opacity"), nb::arg("sigma"), nb::arg("geometry"), nb::arg("camera"), nb::arg("layers"),
               nb::arg("near"), nb::arg("estimator"), nb::arg("entries"), nb::arg("workspace"), nb::arg("stream"),
               nb::arg("rendered_features"), nb::arg("rendered_alpha"), nb::arg("rendered_transmittance"),
               nb::arg("rendered_normal"), nb::arg("rendered_depth"), nb::arg("grad_features"), nb::arg("grad_alpha"),
               nb::arg("grad_normal"), nb::arg("grad_depth"), nb::arg("out_xyz"), nb::arg("out_features"),
               nb::arg("out_opacity"), nb::arg("out_sigma"));
}

}  // namespace fourd::cuda
