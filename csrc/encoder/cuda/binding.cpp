// Python bindings of the image encoder on a GPU; fourd/rendering/ops/encoder/op.py documents the operations.
#include <nanobind/stl/vector.h>

#include <vector>

#include "binding/cuda_arrays.h"
#include "encoder/arguments.h"
#include "encoder/cuda/encoder.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = EncoderArguments<Where>;
template <typename Number>
using Weights = std::vector<Arguments::AnyArray<Number>>;

template <typename Number>
std::vector<Number*> pointers_of(const encoder::Sizes& sizes, const Weights<Number>& weights) {
    require(weights.size() == encoder::kWeightCount, "weights: expected 20 arrays");
    std::vector<Number*> out;
    for (int i = 0; i < encoder::kWeightCount; ++i) {
        require(weights[i].size() == encoder::weight_shape(sizes, i).size(),
                "weights: expected the shapes of the layers");
        out.push_back(weights[i].data());
    }
    return out;
}

void forward(const Arguments::Images& images, const Weights<const float>& weights, int stride, std::uintptr_t stream,
             const Arguments::Array<float, 4>& features, const Arguments::Array<float, 1>& saved) {
    const encoder::Sizes sizes = Arguments::sizes_of(images, stride, features);
    const std::vector<const float*> pointers = pointers_of(sizes, weights);
    require(saved.size() == encoder::cuda::saved_size(sizes), "saved: expected the size from encoder_sizes");
    encoder::cuda::forward(sizes, pointers.data(), images.data(), features.data(), saved.data(), stream_of(stream));
}

void backward(const Arguments::Images& images, const Arguments::Array<const float, 1>& saved,
              const Weights<const float>& weights, int stride, std::uintptr_t stream,
              const Arguments::Array<const float, 4>& gradient, const Arguments::Array<float, 1>& workspace,
              const Weights<float>& out_weights) {
    const encoder::Sizes sizes = Arguments::sizes_of(images, stride, gradient);
    const std::vector<const float*> pointers = pointers_of(sizes, weights);
    const std::vector<float*> out = pointers_of(sizes, out_weights);
    require(saved.size() == encoder::cuda::saved_size(sizes), "saved: expected the result of encode_images");
    require(workspace.size() == encoder::cuda::workspace_size(sizes), "workspace: expected the size from encoder_sizes");
    encoder::cuda::backward(sizes, pointers.data(), saved.data(), gradient.data(), workspace.data(), out.data(),
                            stream_of(stream));
}

// Returns the sizes of `saved` and `workspace` in floats.
std::vector<std::size_t> sizes_of(int images, int height, int width, int stride) {
    const encoder::Sizes sizes = Arguments::sizes_of(images, height, width, stride);
    return {encoder::cuda::saved_size(sizes), encoder::cuda::workspace_size(sizes)};
}

}  // namespace

void bind_encoder(nb::module_& module) {
    module.def("encode_images", &forward, nb::arg("images"), nb::arg("weights"), nb::arg("stride"), nb::arg("stream"),
               nb::arg("features"), nb::arg("saved"));
    module.def("encode_images_backward", &backward, nb::arg("images"), nb::arg("saved"), nb::arg("weights"),
               nb::arg("stride"), nb::arg("stream"), nb::arg("gradient"), nb::arg("workspace"), nb::arg("out_weights"));
    module.def("encoder_sizes", &sizes_of, nb::arg("images"), nb::arg("height"), nb::arg("width"), nb::arg("stride"));
}

}  // namespace fourd::cuda
