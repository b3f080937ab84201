// Python bindings of the image encoder; fourd/rendering/ops/encoder/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <array>
#include <optional>
#include <string>

#include "common/buffer.h"
#include "encoder/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = EncoderArguments<nb::device::cpu>;
using Images = Arguments::Images;
template <typename Number, std::size_t Axes>
using Array = Arguments::Array<Number, Axes>;

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
             const std::string& simd, const Array<float, 4>& features, const std::optional<Array<float, 1>>& saved) {
    const encoder::Sizes sizes = Arguments::sizes_of(images, stride, features);
    const auto layers = split(sizes, weights);
    require(!saved || saved->size() == sizes.images * encoder::saved_size(sizes),
            "saved: expected the size that encoder_saved_size returns, for each image");
    const encoder::Execution execution{clamp_threads(threads), simd_named(simd.c_str())};
    nb::gil_scoped_release release;
    encoder::forward(sizes, layers.data(), images.data(), execution, features.data(), saved ? saved->data() : nullptr);
}

// Without `saved`, the maps are computed again from the images.
void backward(const Images& images, const std::optional<Array<const float, 1>>& saved,
              const Array<const float, 1>& weights, int stride, int threads, const std::string& simd,
              const Array<const float, 4>& gradient, const Array<float, 1>& out_weights) {
    const encoder::Sizes sizes = Arguments::sizes_of(images, stride, gradient);
    const auto layers = split(sizes, weights);
    const auto out = split(sizes, out_weights);
    const std::size_t size = encoder::saved_size(sizes);
    require(!saved || saved->size() == size * sizes.images, "saved: expected the result of encode_images");
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
    return encoder::saved_size(Arguments::sizes_of(1, height, width, stride));
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
