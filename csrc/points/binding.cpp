// Python bindings of the point renderer; fourd/rendering/ops/points/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <vector>

#include "points/arguments.h"
#include "points/cpu/workspace.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = PointArguments<nb::device::cpu>;

// A thread keeps its workspace for the next image unless the workspace has more than kKeptBytes bytes.
constexpr std::size_t kKeptBytes = std::size_t{256} << 20;

class KeptWorkspace {
  public:
    ~KeptWorkspace() {
        if (workspace().bytes() > kKeptBytes) workspace() = points::Workspace();
    }
    points::Workspace& workspace() const {
        thread_local points::Workspace kept;
        return kept;
    }
};

void render(const Arguments::Xyz& xyz, const Arguments::Rows& features, const Arguments::Column& radius,
            const Arguments::Column& density, const std::vector<double>& camera, int layers, double near_depth,
            double transmittance_min, int threads, const std::string& simd, const Arguments::PictureOut& out_features,
            const Arguments::RowsOut& out_alpha, const Arguments::RowsOut& out_depth) {
    const points::Cloud cloud = Arguments::cloud(xyz, features, radius, density);
    const points::Image image = Arguments::image(cloud, out_features, out_alpha, out_depth);
    const points::Settings settings = points_settings(camera, out_alpha.shape(1), out_alpha.shape(0), layers,
                                                      near_depth, transmittance_min, threads, simd);
    nb::gil_scoped_release release;
    points::render(cloud, settings, KeptWorkspace().workspace(), image);
}

void render_backward(const Arguments::Xyz& xyz, const Arguments::Rows& features, const Arguments::Column& radius,
                     const Arguments::Column& density, const std::vector<double>& camera, int layers, double near_depth,
                     int threads, const std::string& simd, const Arguments::Picture& grad_features,
                     const Arguments::Rows& grad_alpha, const std::optional<Arguments::Rows>& grad_depth,
                     const Arguments::XyzOut& out_xyz, const Arguments::RowsOut& out_features,
                     const Arguments::ColumnOut& out_radius, const Arguments::ColumnOut& out_density) {
    const points::Cloud cloud = Arguments::cloud(xyz, features, radius, density);
    const points::ImageGradient gradient = Arguments::image_gradient(cloud, grad_features, grad_alpha, grad_depth);
    const points::CloudGradient out = Arguments::cloud_gradient(cloud, out_xyz, out_features, out_radius, out_density);
    const points::Settings settings =
        points_settings(camera, grad_alpha.shape(1), grad_alpha.shape(0), layers, near_depth, 0.0, threads, simd);
    nb::gil_scoped_release release;
    points::render_backward(cloud, settings, KeptWorkspace().workspace(), gradient, out);
}

void visibility(const Arguments::Xyz& xyz, const Arguments::Column& radius, const Arguments::Column& density,
                const std::vector<double>& camera, std::size_t width, std::size_t height, int layers, double near_depth,
                int threads, const std::string& simd, const Arguments::ColumnOut& out) {
    const points::Cloud cloud = Arguments::bare_cloud(xyz, radius, density);
    require(out.shape(0) == cloud.count, "out: unexpected shape");
    const points::Settings settings = points_settings(camera, width, height, layers, near_depth, 0.0, threads, simd);
    nb::gil_scoped_release release;
    points::visibility(cloud, settings, KeptWorkspace().workspace(), out.data());
}

}  // namespace

void bind_points(nb::module_& module) {
    module.def("render_points", &render, nb::arg("xyz"), nb::arg("features"), nb::arg("radius"), nb::arg("density"),
               nb::arg("camera"), nb::arg("layers"), nb::arg("near"), nb::arg("transmittance_min"), nb::arg("threads"),
               nb::arg("simd"), nb::arg("out_features"), nb::arg("out_alpha"), nb::arg("out_depth"),
               "Sizes: xyz=N features=N,C radius=N density=N camera*21 out_features=H,W,C out_alpha=H,W "
               "out_depth=H,W");
    module.def("render_points_backward", &render_backward, nb::arg("xyz"), nb::arg("features"), nb::arg("radius"),
               nb::arg("density"), nb::arg("camera"), nb::arg("layers"), nb::arg("near"), nb::arg("threads"),
               nb::arg("simd"), nb::arg("grad_features"), nb::arg("grad_alpha"), nb::arg("grad_depth").none(),
               nb::arg("out_xyz"), nb::arg("out_features"), nb::arg("out_radius"), nb::arg("out_density"),
               "Sizes: xyz=N features=N,C radius=N density=N camera*21 grad_features=H,W,C grad_alpha=H,W "
               "grad_depth=H,W out_xyz=N out_features=N,C out_radius=N out_density=N");
    module.def("point_visibility", &visibility, nb::arg("xyz"), nb::arg("radius"), nb::arg("density"),
               nb::arg("camera"), nb::arg("width"), nb::arg("height"), nb::arg("layers"), nb::arg("near"),
               nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               "Sizes: xyz=N radius=N density=N camera*21 width=W height=H out=N");
}

}  // namespace fourd
