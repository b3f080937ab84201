// The point renderer's Python face. fourd/raster/validation.py has checked values; shapes are checked here
// again, since a wrong one would read past an array.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <initializer_list>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "binding/bindings.h"
#include "binding/convert.h"
#include "points/cpu/workspace.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using In = nb::ndarray<const float, nb::numpy, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::numpy, nb::c_contig, nb::device::cpu>;

template <typename Array>
void require(const Array& array, std::initializer_list<std::size_t> shape, const char* name) {
    bool fits = array.ndim() == shape.size();
    std::size_t axis = 0;
    for (const std::size_t size : shape) {
        fits = fits && array.shape(axis) == size;
        ++axis;
    }
    if (!fits) throw std::invalid_argument(std::string(name) + ": unexpected shape");
}

// A thread's memory from one picture to the next; what is more than this is given back.
constexpr std::size_t kKeptBytes = std::size_t{256} << 20;

class KeptWorkspace {
  public:
    ~KeptWorkspace() {
        if (space().bytes() > kKeptBytes) space() = points::Workspace();
    }
    points::Workspace& space() const {
        thread_local points::Workspace kept;
        return kept;
    }
};

points::Cloud cloud_of(const In& xyz, const In& features, const In& radius, const In& density) {
    const std::size_t count = radius.size();
    const std::size_t channels = features.ndim() == 2 ? features.shape(1) : 0;
    if (count > 0x7fffffff || channels < 1 || channels > 32) throw std::invalid_argument("features: unexpected shape");
    require(xyz, {count, 3}, "xyz");
    require(features, {count, channels}, "features");
    require(radius, {count}, "radius");
    require(density, {count}, "density");
    return {xyz.data(), features.data(), radius.data(), density.data(), count, static_cast<int>(channels)};
}

void render(const In& xyz, const In& features, const In& radius, const In& density, const std::vector<double>& camera,
            int layers, double near, double transmittance_min, int threads, const std::string& simd,
            const Out& out_features, const Out& out_alpha, const Out& out_depth) {
    const points::Cloud cloud = cloud_of(xyz, features, radius, density);
    if (out_alpha.ndim() != 2) throw std::invalid_argument("out_alpha: unexpected shape");
    const std::size_t height = out_alpha.shape(0), width = out_alpha.shape(1);
    require(out_features, {height, width, static_cast<std::size_t>(cloud.channels)}, "out_features");
    require(out_depth, {height, width}, "out_depth");
    const points::Settings settings =
        points_settings(camera, width, height, layers, near, transmittance_min, threads, simd);
    nb::gil_scoped_release release;
    points::render(cloud, settings, KeptWorkspace().space(), {out_features.data(), out_alpha.data(), out_depth.data()});
}

void render_backward(const In& xyz, const In& features, const In& radius, const In& density,
                     const std::vector<double>& camera, int layers, double near, int threads, const std::string& simd,
                     const In& grad_features, const In& grad_alpha, const std::optional<In>& grad_depth,
                     const Out& out_xyz, const Out& out_features, const Out& out_radius, const Out& out_density) {
    const points::Cloud cloud = cloud_of(xyz, features, radius, density);
    const std::size_t channels = static_cast<std::size_t>(cloud.channels);
    if (grad_alpha.ndim() != 2) throw std::invalid_argument("grad_alpha: unexpected shape");
    const std::size_t height = grad_alpha.shape(0), width = grad_alpha.shape(1);
    require(grad_features, {height, width, channels}, "grad_features");
    if (grad_depth) require(*grad_depth, {height, width}, "grad_depth");
    require(out_xyz, {cloud.count, 3}, "out_xyz");
    require(out_features, {cloud.count, channels}, "out_features");
    require(out_radius, {cloud.count}, "out_radius");
    require(out_density, {cloud.count}, "out_density");
    const points::Settings settings =
        points_settings(camera, width, height, layers, near, 0.0, threads, simd);
    nb::gil_scoped_release release;
    points::render_backward(
        cloud, settings, KeptWorkspace().space(),
        {grad_features.data(), grad_alpha.data(), grad_depth ? grad_depth->data() : nullptr},
        {out_xyz.data(), out_features.data(), out_radius.data(), out_density.data()});
}

void visibility(const In& xyz, const In& radius, const In& density, const std::vector<double>& camera,
                std::size_t width, std::size_t height, int layers, double near, int threads, const std::string& simd, const Out& out) {
    const std::size_t count = radius.size();
    if (count > 0x7fffffff) throw std::invalid_argument("radius: unexpected shape");
    require(xyz, {count, 3}, "xyz");
    require(radius, {count}, "radius");
    require(density, {count}, "density");
    require(out, {count}, "out");
    const points::Cloud cloud = {xyz.data(), nullptr, radius.data(), density.data(), count, 0};
    const points::Settings settings = points_settings(camera, width, height, layers, near, 0.0, threads, simd);
    nb::gil_scoped_release release;
    points::visibility(cloud, settings, KeptWorkspace().space(), out.data());
}

}  // namespace

void bind_points(nb::module_& module) {
    module.def("render_points", &render);
    module.def("render_points_backward", &render_backward, nb::arg("xyz"), nb::arg("features"), nb::arg("radius"),
               nb::arg("density"), nb::arg("camera"), nb::arg("layers"), nb::arg("near"), nb::arg("threads"),
               nb::arg("simd"), nb::arg("grad_features"), nb::arg("grad_alpha"), nb::arg("grad_depth").none(),
               nb::arg("out_xyz"), nb::arg("out_features"), nb::arg("out_radius"), nb::arg("out_density"));
    module.def("point_visibility", &visibility);
}

}  // namespace fourd
