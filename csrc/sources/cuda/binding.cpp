// Python bindings that sample source views on a GPU. fourd/rendering/ops/sources/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "binding/cuda_arrays.h"
#include "sources/arguments.h"
#include "sources/cuda/sample.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = SourceArguments<Where>;

void require_few(const Arguments::Images& images) {
    require(images.shape(0) <= sources::cuda::kMaxViews, "images: expected at most 16 views on a GPU");
}

void sample(const Arguments::Xyz& xyz, const Arguments::Images& images, const Arguments::Grey& mattes,
            const std::optional<Arguments::Grey>& depth, const std::optional<Arguments::Features>& features,
            const std::vector<double>& cameras, const Arguments::Softness& softness, std::uintptr_t stream,
            const Arguments::ChannelsOut& out_channels, const Arguments::VisibilityOut& out_visibility) {
    require_few(images);
    const Arguments arguments(xyz, images, mattes, depth, features, cameras, &softness, 1, Simd::baseline);
    sources::cuda::sample(arguments.query, arguments.samples(out_channels, out_visibility), stream_of(stream));
}

void sample_backward(const Arguments::Xyz& xyz, const Arguments::Images& images, const Arguments::Grey& mattes,
                     const std::optional<Arguments::Features>& features, const std::vector<double>& cameras,
                     std::uintptr_t stream, const Arguments::Channels& gradient, const Arguments::XyzOut& out_xyz,
                     const std::optional<Arguments::FeaturesOut>& out_features) {
    require_few(images);
    const Arguments arguments(xyz, images, mattes, std::nullopt, features, cameras, nullptr, 1, Simd::baseline);
    sources::cuda::sample_backward(arguments.query, arguments.gradient(gradient),
                                   arguments.gradients(out_xyz, out_features), stream_of(stream));
}

}  // namespace

void bind_sources(nb::module_& module) {
    module.def("sample_sources", &sample, nb::arg("xyz"), nb::arg("images"), nb::arg("mattes"), nb::arg("depth").none(),
               nb::arg("features").none(), nb::arg("cameras"), nb::arg("softness"), nb::arg("stream"),
               nb::arg("out_channels"), nb::arg("out_visibility"));
    module.def("sample_sources_backward", &sample_backward, nb::arg("xyz"), nb::arg("images"), nb::arg("mattes"),
               nb::arg("features").none(), nb::arg("cameras"), nb::arg("stream"), nb::arg("gradient"),
               nb::arg("out_xyz"), nb::arg("out_features").none());
}

}  // namespace fourd::cuda
