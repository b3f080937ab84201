// Python bindings of the image encoder; fourd/rendering/ops/encoder/op.py documents the operations.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <array>
#include <optional>
#include <string>

#include "binding/require.h"
#include "common/buffer.h"
#include "encoder/encoder.h"

namespace nb = nanobind;

namespace fourd {
namespace {

template <typename Number, std::size_t Axes>
using Array = nb::ndarray<Number, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;
using Images = nb::ndarray<const float, nb::shape<-1, 3, -1, -1>, nb::c_contig, nb::device::cpu>;

constexpr std::size_t kLongestSide = 1 << 16, kMaxImages = 1 << 12;

// Checks the sizes and the shape (images, rows, columns, channels) of the features.
template <typename Features>
encoder::Sizes sizes_of(std::size_t images, std::size_t height, std::size_t width, int stride,
                        const Features& features) {
    require(stride == 1 || stride == 2, "stride: expected 1 or 2");
    const std::size_t step = 4 * static_cast<std::size_t>(stride), channels = features.shape(3);
    require(images <= kMaxImages, "images: expected at most 4096");
    require(height >= step && width >= step && height % step == 0 && width % step == 0 && height <= kLongestSide &&
                width <= kLongestSide,
            "images: expected sides that are multiples of 4 * stride, at most 65536");
    require(channels >= 1 && channels <= encoder::kMaxFeatures, "features: expected 1 to 64 channels");
    require(features.shape(0) == images && features.shape(1) == height / stride && features.shape(2) == width / stride,
            "features: expected shape (images, height / stride, width / stride, channels)");
    return {static_cast<int>(images), static_cast<int>(height), static_cast<int>(width), stride,
            static_cast<int>(channels)};
}

// Divides one array into the arrays of all layers.
template <typename Number>
std::array<Number*, encoder::kWeightCount> split(const encoder::Sizes& sizes, const Array<Number, 1>& weights) {
    std::array<Number*, encoder::kWeightCount> out{};
    std::size_t used = 0;
    for (int i = 0; i < encoder::kWeightCount; ++i) {
        out[i] = weights.data() + used;
        used += encoder::weight_shape(sizes, i).size();
    }
    require(weights.size() == used, "weights: expected the weights of all layers");
    return out;
}

void forward(const Images& images, const Array<const float, 1>& weights, int stride, int threads,
             const std::string& simd, const Array<float, 4>& features, const std::optional<Array<float, 2>>& saved) {
    const encoder::Sizes sizes = sizes_of(images.shape(0), images.shape(2), images.shape(3), stride, features);
    const auto layers = split(sizes, weights);
    require(!saved || (saved->shape(0) == images.shape(0) && saved->shape(1) == encoder::saved_size(sizes)),
            "saved: expected the size that saved_size returns, for each image");
    const encoder::Execution execution{clamp_threads(threads), simd_named(simd.c_str())};
    nb::gil_scoped_release release;
    encoder::forward(sizes, layers.data(), images.data(), execution, features.data(), saved ? saved->data() : nullptr);
}

// Without `saved`, the maps are computed again from the images.
void backward(const Images& images, const std::optional<Array<const float, 2>>& saved,
              const Array<const float, 1>& weights, int stride, int threads, const std::string& simd,
              const Array<const float, 4>& gradient, const Array<float, 1>& out_weights) {
    const encoder::Sizes sizes = sizes_of(images.shape(0), images.shape(2), images.shape(3), stride, gradient);
    const auto layers = split(sizes, weights);
    const auto out = split(sizes, out_weights);
    const std::size_t size = encoder::saved_size(sizes);
    require(!saved || (saved->shape(0) == images.shape(0) && saved->shape(1) == size),
            "saved: expected the result of encode_images");
    const encoder::Execution execution{clamp_threads(threads), simd_named(simd.c_str())};
    nb::gil_scoped_release release;
    Buffer<float> again(saved ? 0 : size * sizes.images), features(saved ? 0 : gradient.size());
    if (!saved) {
        encoder::forward(sizes, layers.data(), images.data(), execution, features.data(), again.data());
    }
    encoder::backward(sizes, layers.data(), saved ? saved->data() : again.data(), gradient.data(), execution,
                      out.data());
}

std::size_t saved_size(int height, int width, int stride) {
    require(stride == 1 || stride == 2, "stride: expected 1 or 2");
    require(height >= 1 && width >= 1 && height <= static_cast<int>(kLongestSide) &&
                width <= static_cast<int>(kLongestSide),
            "height, width: expected 1 to 65536");
    return encoder::saved_size({1, height, width, stride, 1});
}

}  // namespace

void bind_encoder(nb::module_& module) {
    module.def("encode_images", &forward, nb::arg("images"), nb::arg("weights"), nb::arg("stride"), nb::arg("threads"),
               nb::arg("simd"), nb::arg("features"), nb::arg("saved").none(),
               "Sizes: images=B,4H,4W weights=145F+19400 stride=1 features=B,4H,4W,F\n"
               "Sizes: images=B,8H,8W weights=145F+19400 stride=2 features=B,4H,4W,F");
    module.def("encode_images_backward", &backward, nb::arg("images"), nb::arg("saved").none(), nb::arg("weights"),
               nb::arg("stride"), nb::arg("threads"), nb::arg("simd"), nb::arg("gradient"), nb::arg("out_weights"),
               "Sizes: images=B,4H,4W weights=145F+19400 stride=1 gradient=B,4H,4W,F out_weights=145F+19400\n"
               "Sizes: images=B,8H,8W weights=145F+19400 stride=2 gradient=B,4H,4W,F out_weights=145F+19400");
    module.def("encoder_saved_size", &saved_size, nb::arg("height"), nb::arg("width"), nb::arg("stride"));
}

}  // namespace fourd
