// Python bindings that sample source views. fourd/rendering/ops/sources/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>

#include "sources/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = SourceArguments<nb::device::cpu>;

Arguments arguments_of(const Arguments::Xyz& xyz, const Arguments::Images& images, const Arguments::Grey& mattes,
                       const std::optional<Arguments::Grey>& depth, const std::optional<Arguments::Features>& features,
                       const std::vector<double>& cameras, const Arguments::Softness* softness, int threads,
                       const std::string& simd) {
    return Arguments(xyz, images, mattes, depth, features, cameras, softness, clamp_threads(threads),
                     simd_named(simd.c_str()));
}

void sample(const Arguments::Xyz& xyz, const Arguments::Images& images, const Arguments::Grey& mattes,
            const std::optional<Arguments::Grey>& depth, const std::optional<Arguments::Features>& features,
            const std::vector<double>& cameras, const Arguments::Softness& softness, int threads,
            const std::string& simd, const Arguments::ChannelsOut& out_channels,
            const Arguments::VisibilityOut& out_visibility) {
    const Arguments arguments = arguments_of(xyz, images, mattes, depth, features, cameras, &softness, threads, simd);
    const sources::Samples out = arguments.samples(out_channels, out_visibility);
    nb::gil_scoped_release release;
    sources::sample(arguments.query, out);
}

void sample_backward(const Arguments::Xyz& xyz, const Arguments::Images& images, const Arguments::Grey& mattes,
                     const std::optional<Arguments::Features>& features, const std::vector<double>& cameras,
                     int threads, const std::string& simd, const Arguments::Channels& gradient,
                     const Arguments::XyzOut& out_xyz, const std::optional<Arguments::FeaturesOut>& out_features) {
    const Arguments arguments =
        arguments_of(xyz, images, mattes, std::nullopt, features, cameras, nullptr, threads, simd);
    const float* const from = arguments.gradient(gradient);
    const sources::Gradients out = arguments.gradients(out_xyz, out_features);
    nb::gil_scoped_release release;
    sources::sample_backward(arguments.query, from, out);
}

}  // namespace

void bind_sources(nb::module_& module) {
    module.def("sample_sources", &sample, nb::arg("xyz"), nb::arg("images"), nb::arg("mattes"), nb::arg("depth").none(),
               nb::arg("features").none(), nb::arg("cameras"), nb::arg("softness"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("out_channels"), nb::arg("out_visibility"),
               "Sizes: xyz=N images=B,H,W mattes=B,H,W depth=B,H,W features=B,Y,X,C cameras*21B softness=N "
               "out_channels=B,C+3,N out_visibility=B,N");
    module.def("sample_sources_backward", &sample_backward, nb::arg("xyz"), nb::arg("images"), nb::arg("mattes"),
               nb::arg("features").none(), nb::arg("cameras"), nb::arg("threads"), nb::arg("simd"), nb::arg("gradient"),
               nb::arg("out_xyz"), nb::arg("out_features").none(),
               "Sizes: xyz=N images=B,H,W mattes=B,H,W features=B,Y,X,C cameras*21B gradient=B,C+3,N out_xyz=N "
               "out_features=B,Y,X,C");
}

}  // namespace fourd
