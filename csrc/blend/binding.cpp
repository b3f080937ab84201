// Python bindings of the blend MLP; fourd/rendering/ops/blend/op.py documents the operations.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <string>

#include "binding/require.h"
#include "blend/blend.h"

namespace nb = nanobind;

namespace fourd {
namespace {

template <typename Number, std::size_t Axes>
using Array = nb::ndarray<Number, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;

blend::Mlp mlp_of(const Array<const float, 2>& weight, const Array<const float, 1>& out, float bias, float range) {
    require(weight.shape(0) >= 1 && weight.shape(0) <= blend::kMaxChannels, "weight: expected 1 to 64 channels");
    require(weight.shape(1) >= 1 && weight.shape(1) <= blend::kMaxHidden, "weight: expected a width of 1 to 256");
    require(out.shape(0) == weight.shape(1), "out: expected the hidden layer's width");
    return {
        weight.data(), out.data(), bias, range, static_cast<int>(weight.shape(0)), static_cast<int>(weight.shape(1))};
}

blend::Inputs inputs_of(const blend::Mlp& mlp, const Array<const float, 2>& point, const Array<const float, 3>& samples,
                        int threads, const std::string& simd) {
    const std::size_t count = point.shape(0);
    require(count <= 0x7fffffff, "point: expected at most 2^31 - 1 points");
    require(point.shape(1) == static_cast<std::size_t>(mlp.hidden), "point: expected the hidden layer's width");
    require(samples.shape(1) == static_cast<std::size_t>(mlp.channels) && samples.shape(2) == count,
            "samples: expected shape (views, channels, points)");
    return {point.data(), samples.data(), count, samples.shape(0), clamp_threads(threads), simd_named(simd.c_str())};
}

template <typename Number>
void require_logits(const Array<Number, 2>& array, const blend::Inputs& inputs) {
    require(array.shape(0) == inputs.views && array.shape(1) == inputs.count, "logits: expected shape (views, points)");
}

void logits(const Array<const float, 2>& point, const Array<const float, 3>& samples,
            const Array<const float, 2>& weight, const Array<const float, 1>& out, float bias, float range, int threads,
            const std::string& simd, const Array<float, 2>& result) {
    const blend::Mlp mlp = mlp_of(weight, out, bias, range);
    const blend::Inputs inputs = inputs_of(mlp, point, samples, threads, simd);
    require_logits(result, inputs);
    nb::gil_scoped_release release;
    blend::logits(mlp, inputs, result.data());
}

void logits_backward(const Array<const float, 2>& point, const Array<const float, 3>& samples,
                     const Array<const float, 2>& weight, const Array<const float, 1>& out, float bias, float range,
                     int threads, const std::string& simd, const Array<const float, 2>& result,
                     const Array<const float, 2>& gradient, const Array<float, 2>& to_point,
                     const Array<float, 3>& to_samples, const Array<float, 2>& to_weight, const Array<float, 1>& to_out,
                     const Array<float, 1>& to_bias) {
    const blend::Mlp mlp = mlp_of(weight, out, bias, range);
    const blend::Inputs inputs = inputs_of(mlp, point, samples, threads, simd);
    require_logits(result, inputs);
    require_logits(gradient, inputs);
    require(to_point.size() == point.size() && to_samples.size() == samples.size() &&
                to_weight.size() == weight.size() && to_out.size() == out.size() && to_bias.size() == 1,
            "gradients: expected the shapes of the inputs");
    nb::gil_scoped_release release;
    blend::logits_backward(mlp, inputs, result.data(), gradient.data(),
                           {to_point.data(), to_samples.data(), to_weight.data(), to_out.data(), to_bias.data()});
}

}  // namespace

void bind_blend(nb::module_& module) {
    module.def("blend_logits", &logits, nb::arg("point"), nb::arg("samples"), nb::arg("weight"), nb::arg("out"),
               nb::arg("bias"), nb::arg("range"), nb::arg("threads"), nb::arg("simd"), nb::arg("logits"),
               "Sizes: point=N,H samples=V,C,N weight=C,H out=H logits=V,N");
    module.def("blend_logits_backward", &logits_backward, nb::arg("point"), nb::arg("samples"), nb::arg("weight"),
               nb::arg("out"), nb::arg("bias"), nb::arg("range"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("logits"), nb::arg("grad_logits"), nb::arg("out_point"), nb::arg("out_samples"),
               nb::arg("out_weight"), nb::arg("out_out"), nb::arg("out_bias"),
               "Sizes: point=N,H samples=V,C,N weight=C,H out=H logits=V,N grad_logits=V,N out_point=N,H "
               "out_samples=V,C,N out_weight=C,H out_out=H out_bias=1");
}

}  // namespace fourd
