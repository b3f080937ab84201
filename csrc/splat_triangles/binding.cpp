// Python bindings of triangle splatting; fourd/rendering/ops/splat_triangles/op.py documents the operations.
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <vector>

#include "splat_triangles/arguments.h"
#include "splat_triangles/cpu/workspace.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = SplatArguments<nb::device::cpu>;

// A thread keeps its workspace for the next image unless the workspace has more than kKeptBytes bytes.
constexpr std::size_t kKeptBytes = std::size_t{256} << 20;

class KeptWorkspace {
  public:
    ~KeptWorkspace() {
        if (workspace().bytes() > kKeptBytes) workspace() = splat_triangles::Workspace();
    }
    splat_triangles::Workspace& workspace() const {
        thread_local splat_triangles::Workspace kept;
        return kept;
    }
};

void render(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
            const Arguments::Column& opacity, const Arguments::Column& sigma, bool geometry,
            const std::vector<double>& camera, int layers, double near_depth, int threads, const std::string& simd,
            const Arguments::PictureOut& out_features, const Arguments::RowsOut& out_alpha,
            const Arguments::RowsOut& out_transmittance, const Arguments::PictureOut& out_normal,
            const Arguments::RowsOut& out_depth, const Arguments::ColumnOut& out_weight) {
    const splat_triangles::Mesh mesh = Arguments::mesh(xyz, tri, features, opacity, sigma, geometry);
    const splat_triangles::Image image =
        Arguments::image(mesh, out_features, out_alpha, out_transmittance, out_normal, out_depth);
    require(out_weight.shape(0) == mesh.count, "out_weight: unexpected shape");
    const splat_triangles::Settings settings =
        splat_settings(camera, out_alpha.shape(1), out_alpha.shape(0), layers, near_depth, threads, simd);
    nb::gil_scoped_release release;
    splat_triangles::render(mesh, settings, KeptWorkspace().workspace(), image, out_weight.data());
}

void render_backward(const Arguments::Xyz& xyz, const Arguments::Triangles& tri, const Arguments::Rows& features,
                     const Arguments::Column& opacity, const Arguments::Column& sigma, bool geometry,
                     const std::vector<double>& camera, int layers, double near_depth, int threads,
                     const std::string& simd, const Arguments::PictureOut& rendered_features,
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
        splat_settings(camera, grad_alpha.shape(1), grad_alpha.shape(0), layers, near_depth, threads, simd);
    nb::gil_scoped_release release;
    splat_triangles::render_backward(mesh, settings, KeptWorkspace().workspace(), gradient, out);
}

}  // namespace

void bind_splat_triangles(nb::module_& module) {
    module.def("splat_triangles", &render, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"), nb::arg("opacity"),
               nb::arg("sigma"), nb::arg("geometry"), nb::arg("camera"), nb::arg("layers"), nb::arg("near"),
               nb::arg("threads"), nb::arg("simd"), nb::arg("out_features"), nb::arg("out_alpha"),
               nb::arg("out_transmittance"), nb::arg("out_normal"), nb::arg("out_depth"), nb::arg("out_weight"),
               "Sizes: xyz=V tri=T tri<V features=T,C opacity=T sigma=T camera*21 out_features=H,W,C out_alpha=H,W "
               "out_transmittance=H,W out_normal=H,W,3 out_depth=H,W out_weight=T\n"
               "Sizes: xyz=V tri=T tri<V features=T,C+4 opacity=T sigma=T camera*21 out_features=H,W,C "
               "out_alpha=H,W out_transmittance=H,W out_normal=H,W,3 out_depth=H,W out_weight=T");
    module.def("splat_triangles_backward", &render_backward, nb::arg("xyz"), nb::arg("tri"), nb::arg("features"),
               nb::arg("opacity"), nb::arg("sigma"), nb::arg("geometry"), nb::arg("camera"), nb::arg("layers"),
               nb::arg("near"), nb::arg("threads"), nb::arg("simd"), nb::arg("rendered_features"),
               nb::arg("rendered_alpha"), nb::arg("rendered_transmittance"), nb::arg("rendered_normal"),
               nb::arg("rendered_depth"), nb::arg("grad_features"), nb::arg("grad_alpha"), nb::arg("grad_normal"),
               nb::arg("grad_depth"), nb::arg("out_xyz"), nb::arg("out_features"), nb::arg("out_opacity"),
               nb::arg("out_sigma"),
               "Sizes: xyz=V tri=T tri<V features=T,C opacity=T sigma=T camera*21 rendered_features=H,W,C "
               "rendered_alpha=H,W rendered_transmittance=H,W rendered_normal=H,W,3 rendered_depth=H,W "
               "grad_features=H,W,C grad_alpha=H,W grad_normal=H,W,3 grad_depth=H,W out_xyz=V out_features=T,C "
               "out_opacity=T out_sigma=T\n"
               "Sizes: xyz=V tri=T tri<V features=T,C+4 opacity=T sigma=T camera*21 rendered_features=H,W,C "
               "rendered_alpha=H,W rendered_transmittance=H,W rendered_normal=H,W,3 rendered_depth=H,W "
               "grad_features=H,W,C grad_alpha=H,W grad_normal=H,W,3 grad_depth=H,W out_xyz=V out_features=T,C+4 "
               "out_opacity=T out_sigma=T");
}

}  // namespace fourd
