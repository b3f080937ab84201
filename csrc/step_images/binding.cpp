// Python bindings of the images of a training step; fourd/rendering/ops/step_images/op.py documents the operations.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <string>
#include <vector>

#include "binding/require.h"
#include "step_images/step_images.h"

namespace nb = nanobind;

namespace fourd {
namespace {

template <typename Number, std::size_t Axes>
using Array = nb::ndarray<Number, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;
template <typename Number, int Channels>
using Picture = nb::ndarray<Number, nb::shape<-1, -1, Channels>, nb::c_contig, nb::device::cpu>;
template <typename Number>
using Planes = nb::ndarray<Number, nb::shape<-1, 3, -1, -1>, nb::c_contig, nb::device::cpu>;
using Bytes = Picture<const std::uint8_t, 3>;
using Mask = Array<const std::uint8_t, 2>;

constexpr std::size_t kLongestSide = 1 << 16, kMaxViews = 1 << 12;

step_images::Execution execution_of(int threads, const std::string& simd) {
    return {clamp_threads(threads), simd_named(simd.c_str())};
}

step_images::View view_of(const Bytes& rgb, const Mask& matte) {
    require(rgb.shape(0) == matte.shape(0) && rgb.shape(1) == matte.shape(1), "matte: expected the size of rgb");
    require(rgb.shape(0) <= kLongestSide && rgb.shape(1) <= kLongestSide, "rgb: expected sides of at most 65536");
    return {rgb.data(), matte.data(), static_cast<int>(rgb.shape(0)), static_cast<int>(rgb.shape(1))};
}

const float* background_of(const std::vector<float>& background) {
    require(background.size() == 3, "background: expected 3 numbers");
    return background.data();
}

void convert_views(const std::vector<Bytes>& rgb, const std::vector<Mask>& mattes, int threads,
                   const std::string& simd, const Planes<float>& out_images, const Array<float, 3>& out_mattes) {
    const std::size_t height = out_images.shape(2), width = out_images.shape(3);
    require(rgb.size() == mattes.size() && rgb.size() <= kMaxViews, "mattes: expected one for each view");
    require(out_images.shape(0) == rgb.size() && out_mattes.shape(0) == rgb.size() && out_mattes.shape(1) == height &&
                out_mattes.shape(2) == width,
            "out_images, out_mattes: expected one image and one matte for each view");
    require(height <= kLongestSide && width <= kLongestSide && height * rgb.size() <= 0x7fffffff,
            "out_images: expected sides of at most 65536");
    std::vector<step_images::View> views;
    for (std::size_t i = 0; i < rgb.size(); ++i) {
        views.push_back(view_of(rgb[i], mattes[i]));
        require(rgb[i].shape(0) <= height && rgb[i].shape(1) <= width, "rgb: expected views that fit into the images");
    }
    const step_images::Execution execution = execution_of(threads, simd);
    nb::gil_scoped_release release;
    step_images::convert_views(views.data(), static_cast<int>(views.size()), static_cast<int>(height),
                               static_cast<int>(width), execution, out_images.data(), out_mattes.data());
}

void premultiply(const Bytes& rgb, const Mask& matte, int threads, const std::string& simd,
                 const Picture<float, 3>& out_rgb, const Array<float, 2>& out_matte) {
    const step_images::View view = view_of(rgb, matte);
    require(out_rgb.size() == rgb.size() && out_matte.size() == matte.size(), "out: expected the shapes of the inputs");
    const step_images::Execution execution = execution_of(threads, simd);
    nb::gil_scoped_release release;
    step_images::premultiply(view, execution, out_rgb.data(), out_matte.data());
}

// Checks that an image of pixels and one of samples belong together.
template <typename Features, typename Alpha>
step_images::Grid grid_of(std::size_t height, std::size_t width, int samples, const Features& features,
                          const Alpha& alpha) {
    require(samples >= 1 && samples <= 64, "samples: expected 1 to 64");
    require(height <= kLongestSide && width <= kLongestSide, "out: expected sides of at most 65536");
    const std::size_t rows = height * samples, columns = width * samples;
    require(features.shape(0) == rows && features.shape(1) == columns && alpha.shape(0) == rows &&
                alpha.shape(1) == columns,
            "features, alpha: expected shapes (samples * height, samples * width, 4) and without the 4");
    return {static_cast<int>(height), static_cast<int>(width), samples};
}

void resolve(const Picture<const float, 4>& features, const Array<const float, 2>& alpha,
             const std::vector<float>& background, int samples, int threads, const std::string& simd,
             const Picture<float, 3>& out_colour, const Array<float, 2>& out_last,
             const Picture<float, 3>& out_prediction) {
    const std::size_t height = out_last.shape(0), width = out_last.shape(1);
    const step_images::Grid grid = grid_of(height, width, samples, features, alpha);
    require(out_colour.size() == 3 * out_last.size() && out_prediction.size() == 3 * out_last.size(),
            "out_colour, out_prediction: expected the size of out_last");
    const float* colour = background_of(background);
    const step_images::Execution execution = execution_of(threads, simd);
    nb::gil_scoped_release release;
    step_images::resolve(grid, {features.data(), alpha.data()}, colour, execution,
                         {out_colour.data(), out_last.data(), out_prediction.data()});
}

void resolve_backward(const std::optional<Picture<const float, 3>>& colour,
                      const std::optional<Array<const float, 2>>& last,
                      const std::optional<Picture<const float, 3>>& prediction, const std::vector<float>& background,
                      int samples, int threads, const std::string& simd, const Picture<float, 4>& out_features,
                      const Array<float, 2>& out_alpha) {
    require(samples >= 1 && samples <= 64, "samples: expected 1 to 64");
    const std::size_t height = out_alpha.shape(0) / samples, width = out_alpha.shape(1) / samples;
    const step_images::Grid grid = grid_of(height, width, samples, out_features, out_alpha);
    const std::size_t pixels = height * width;
    require((!colour || colour->size() == 3 * pixels) && (!last || last->size() == pixels) &&
                (!prediction || prediction->size() == 3 * pixels),
            "colour, last, prediction: expected the size of the image");
    const float* behind = background_of(background);
    const step_images::Execution execution = execution_of(threads, simd);
    nb::gil_scoped_release release;
    step_images::resolve_backward(grid,
                                  {colour ? colour->data() : nullptr, last ? last->data() : nullptr,
                                   prediction ? prediction->data() : nullptr},
                                  behind, execution, out_features.data(), out_alpha.data());
}

void add_background(const Picture<const float, 3>& rgb, const Array<const float, 2>& alpha,
                    const std::vector<float>& background, int threads, const std::string& simd,
                    const Picture<float, 3>& out) {
    require(rgb.size() == 3 * alpha.size() && out.size() == rgb.size(), "rgb, alpha, out: expected equal sizes");
    const float* colour = background_of(background);
    const step_images::Execution execution = execution_of(threads, simd);
    nb::gil_scoped_release release;
    step_images::add_background(alpha.size(), rgb.data(), alpha.data(), colour, execution, out.data());
}

double mean_square(const Array<const float, 2>& values, const std::optional<Array<const float, 2>>& truth, int first,
                   bool clamps, float upstream, int threads, const std::string& simd,
                   const std::optional<Array<float, 2>>& out_gradient) {
    require(values.shape(1) >= 1 && values.shape(1) <= 0x7fffffff, "values: expected at least one column");
    const int columns = static_cast<int>(values.shape(1));
    require(first >= 0 && first < columns, "first: expected a column of the values");
    require(!truth || (truth->shape(0) == values.shape(0) && truth->shape(1) == values.shape(1)),
            "truth: expected the shape of the values");
    require(!out_gradient ||
                (out_gradient->shape(0) == values.shape(0) && out_gradient->shape(1) == values.shape(1) && !clamps),
            "out_gradient: expected the shape of the values, without clamping");
    const step_images::Execution execution = execution_of(threads, simd);
    nb::gil_scoped_release release;
    return step_images::mean_square({values.shape(0), columns, first}, values.data(), truth ? truth->data() : nullptr,
                                    clamps, execution, upstream, out_gradient ? out_gradient->data() : nullptr);
}

}  // namespace

void bind_step_images(nb::module_& module) {
    module.def("convert_views", &convert_views, nb::arg("rgb"), nb::arg("mattes"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("out_images"), nb::arg("out_mattes"),
               "Sizes: rgb*B=H,W mattes*B=H,W out_images=B,H+Y,W+X out_mattes=B,H+Y,W+X");
    module.def("premultiply", &premultiply, nb::arg("rgb"), nb::arg("matte"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("out_rgb"), nb::arg("out_matte"), "Sizes: rgb=H,W matte=H,W out_rgb=H,W out_matte=H,W");
    module.def("resolve_samples", &resolve, nb::arg("features"), nb::arg("alpha"), nb::arg("background"),
               nb::arg("samples"), nb::arg("threads"), nb::arg("simd"), nb::arg("out_colour"), nb::arg("out_last"),
               nb::arg("out_prediction"),
               "Sizes: features=2H,2W alpha=2H,2W background*3 samples=2 out_colour=H,W out_last=H,W "
               "out_prediction=H,W");
    module.def("resolve_samples_backward", &resolve_backward, nb::arg("colour").none(), nb::arg("last").none(),
               nb::arg("prediction").none(), nb::arg("background"), nb::arg("samples"), nb::arg("threads"),
               nb::arg("simd"), nb::arg("out_features"), nb::arg("out_alpha"),
               "Sizes: colour=H,W last=H,W prediction=H,W background*3 samples=2 out_features=2H,2W out_alpha=2H,2W");
    module.def("add_background", &add_background, nb::arg("rgb"), nb::arg("alpha"), nb::arg("background"),
               nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               "Sizes: rgb=H,W alpha=H,W background*3 out=H,W");
    module.def("mean_square", &mean_square, nb::arg("values"), nb::arg("truth").none(), nb::arg("first"),
               nb::arg("clamps"), nb::arg("upstream"), nb::arg("threads"), nb::arg("simd"), nb::arg("out_gradient").none(),
               "Sizes: values=N,C truth=N,C out_gradient=N,C");
}

}  // namespace fourd
