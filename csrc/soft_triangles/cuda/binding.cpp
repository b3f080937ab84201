// Python bindings of soft rasterization on a GPU; fourd/rendering/ops/soft_triangles/cuda.py passes the memory and the CUDA
// stream.
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <utility>
#include <vector>

#include "binding/cuda_arrays.h"
#include "points/cuda/entry_arguments.h"
#include "soft_triangles/arguments.h"
#include "soft_triangles/cuda/render.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = SoftArguments<Where>;

tiles::cuda::EntryBuffer checked_buffer(const EntryBufferArguments& buffer, const soft_triangles::Mesh& mesh,
                                        const tiles::Pinhole& camera) {
    return buffer.checked(soft_triangles::cuda::workspace_bytes(mesh.count, mesh.channels, camera.width, camera.height,
                                                                buffer.entries));
}

// Returns the number of (triangle, tile) entries to allocate, and the size of the workspace in bytes.
std::pair<std::size_t, std::size_t> plan(device::EntryEstimator& estimator, std::size_t count, int channels, int width,
                                         int height) {
    const std::size_t entries = estimator.entries(count);
    return {entries, soft_triangles::cuda::workspace_bytes(count, channels, width, height, entries)};
}

void render(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
            const std::vector<double>& camera, const std::vector<double>& softness, int layers,
            const device::EntryEstimator& estimator, std::size_t entries, const Workspace& workspace,
            std::uintptr_t stream, const Arguments::PictureOut& out_features, const Arguments::RowsOut& out_alpha) {
    const soft_triangles::Mesh mesh = Arguments::mesh(xyz, tri, features);
    const soft_triangles::Image image = Arguments::image(mesh, out_features, out_alpha);
    const soft_triangles::Settings settings =
        soft_settings(camera, out_alpha.shape(1), out_alpha.shape(0), softness, layers, 1, "");
    soft_triangles::cuda::render(mesh, settings,
                                 checked_buffer({estimator, entries, workspace}, mesh, settings.camera), image,
                                 stream_of(stream));
}

void render_backward(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
                     const std::vector<double>& camera, const std::vector<double>& softness, int layers,
                     const device::EntryEstimator& estimator, std::size_t entries, const Workspace& workspace,
                     std::uintptr_t stream, const Arguments::Picture& grad_features, const Arguments::Rows& grad_alpha,
                     const Arguments::XyzOut& out_xyz, const Arguments::RowsOut& out_features) {
    const soft_triangles::Mesh mesh = Arguments::mesh(xyz, tri, features);
    const soft_triangles::ImageGradient gradient = Arguments::gradient(mesh, grad_features, grad_alpha);
    const soft_triangles::MeshGradient out = Arguments::mesh_gradient(mesh, out_xyz, out_features);
    const soft_triangles::Settings settings =
        soft_settings(camera, grad_alpha.shape(1), grad_alpha.shape(0), softness, layers, 1, "");
    soft_triangles::cuda::render_backward(mesh, settings,
                                          checked_buffer({estimator, entries, workspace}, mesh, settings.camera),
                                          gradient, out, stream_of(stream));
}

}  // namespace

void bind_soft_triangles(nb::module_& module) {
    module.def("plan_soft_triangles", &plan, nb::arg("estimator"), nb::arg("count"), nb::arg("channels"),
               nb::arg("width"), nb::arg("height"),
               "The number of entries to allocate, and the bytes of workspace, for the next image.");
    module.def("rasterize_soft", &render, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"), nb::arg("camera"),
               nb::arg("softness"), nb::arg("layers"), nb::arg("estimator"), nb::arg("entries"), nb::arg("workspace"),
               nb::arg("stream"), nb::arg("out_features"), nb::arg("out_alpha"));
    module.def("rasterize_soft_backward", &render_backward, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"),
               nb::arg("camera"), nb::arg("softness"), nb::arg("layers"), nb::arg("estimator"), nb::arg("entries"),
               nb::arg("workspace"), nb::arg("stream"), nb::arg("grad_features"), nb::arg("grad_alpha"),
               nb::arg("out_xyz"), nb::arg("out_features"));
}

}  // namespace fourd::cuda
