// Python bindings of soft rasterization; fourd/rendering/ops/soft_triangles/op.py documents the operations.
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <vector>

#include "soft_triangles/arguments.h"
#include "soft_triangles/cpu/workspace.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = SoftArguments<nb::device::cpu>;

// A thread keeps its workspace for the next image unless the workspace has more than kKeptBytes bytes.
constexpr std::size_t kKeptBytes = std::size_t{128} << 20;

class KeptWorkspace {
  public:
    ~KeptWorkspace() {
        if (workspace().bytes() > kKeptBytes) workspace() = soft_triangles::Workspace();
    }
    soft_triangles::Workspace& workspace() const {
        thread_local soft_triangles::Workspace kept;
        return kept;
    }
};

void render(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
            const std::vector<double>& camera, const std::vector<double>& softness, int layers, int threads,
            const std::string& simd, const Arguments::PictureOut& out_features, const Arguments::RowsOut& out_alpha) {
    const soft_triangles::Mesh mesh = Arguments::mesh(xyz, tri, features);
    const soft_triangles::Image image = Arguments::image(mesh, out_features, out_alpha);
    const soft_triangles::Settings settings =
        soft_settings(camera, out_alpha.shape(1), out_alpha.shape(0), softness, layers, threads, simd);
    nb::gil_scoped_release release;
    soft_triangles::render(mesh, settings, KeptWorkspace().workspace(), image);
}

void render_backward(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
                     const std::vector<double>& camera, const std::vector<double>& softness, int layers, int threads,
                     const std::string& simd, const Arguments::Picture& grad_features,
                     const Arguments::Rows& grad_alpha, const Arguments::XyzOut& out_xyz,
                     const Arguments::RowsOut& out_features) {
    const soft_triangles::Mesh mesh = Arguments::mesh(xyz, tri, features);
    const soft_triangles::ImageGradient gradient = Arguments::gradient(mesh, grad_features, grad_alpha);
    const soft_triangles::MeshGradient out = Arguments::mesh_gradient(mesh, out_xyz, out_features);
    const soft_triangles::Settings settings =
        soft_settings(camera, grad_alpha.shape(1), grad_alpha.shape(0), softness, layers, threads, simd);
    nb::gil_scoped_release release;
    soft_triangles::render_backward(mesh, settings, KeptWorkspace().workspace(), gradient, out);
}

}  // namespace

void bind_soft_triangles(nb::module_& module) {
    module.def("rasterize_soft", &render, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"), nb::arg("camera"),
               nb::arg("softness"), nb::arg("layers"), nb::arg("threads"), nb::arg("simd"), nb::arg("out_features"),
               nb::arg("out_alpha"),
               "Sizes: xyz=V tri=T tri<V features=T,C camera*21 softness*7 out_features=H,W,C out_alpha=H,W");
    module.def("rasterize_soft_backward", &render_backward, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"),
               nb::arg("camera"), nb::arg("softness"), nb::arg("layers"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("grad_features"), nb::arg("grad_alpha"), nb::arg("out_xyz"), nb::arg("out_features"),
               "Sizes: xyz=V tri=T tri<V features=T,C camera*21 softness*7 grad_features=H,W,C grad_alpha=H,W "
               "out_xyz=V out_features=T,C");
}

}  // namespace fourd
