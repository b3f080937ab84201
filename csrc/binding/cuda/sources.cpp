// Source views sampled on a GPU: fourd/model/source_sampling.py says what is computed.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <vector>

#include "binding/convert.h"
#include "binding/cuda/arrays.h"
#include "sources/cuda/sample.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Xyz = Array<const float, nb::shape<-1, 3>>;
using XyzOut = Array<float, nb::shape<-1, 3>>;
using Images = Array<const float, nb::shape<-1, 3, -1, -1>>;
using Features = Array<const float, nb::ndim<4>>;
using FeaturesOut = Array<float, nb::ndim<4>>;
using Grey = Array<const float, nb::ndim<3>>;
using Channels = Array<const float, nb::ndim<3>>;
using ChannelsOut = Array<float, nb::ndim<3>>;
using TrustOut = Array<float, nb::ndim<2>>;

constexpr std::size_t kNumbers = 21;  // of a camera: K, R (row by row) and T
constexpr std::size_t kLongestSide = 1 << 24;

std::vector<sources::Pinhole> cameras_of(const std::vector<double>& numbers, std::size_t views) {
    require(views >= 1 && views <= sources::cuda::kMostViews, "images: expected 1 to 16 views on a GPU");
    require(numbers.size() == kNumbers * views, "cameras: expected 21 numbers a view");
    std::vector<sources::Pinhole> out(views);
    for (std::size_t view = 0; view < views; ++view) {
        const double* from = numbers.data() + kNumbers * view;
        for (int i = 0; i < 9; ++i) out[view].intrinsics[i] = static_cast<float>(from[i]);
        for (int i = 0; i < 9; ++i) out[view].rotation[i] = static_cast<float>(from[9 + i]);
        for (int i = 0; i < 3; ++i) out[view].translation[i] = static_cast<float>(from[18 + i]);
    }
    return out;
}

sources::Query query_of(const Xyz& xyz, const Images& images, const Grey& mattes, const std::optional<Grey>& depth,
                        const std::optional<Features>& features, const std::vector<sources::Pinhole>& cameras,
                        float softness) {
    const std::size_t views = images.shape(0), height = images.shape(2), width = images.shape(3);
    require(xyz.shape(0) <= 0x7fffffff, "xyz: expected at most 2^31 - 1 points");
    require(height >= 1 && width >= 1 && height <= kLongestSide && width <= kLongestSide, "images: unexpected shape");
    require(softness > 0, "softness: expected a depth above 0");
    const auto fits = [&](const Grey& grey) {
        return grey.shape(0) == views && grey.shape(1) == height && grey.shape(2) == width;
    };
    require(fits(mattes), "mattes: expected the images' shape");
    require(!depth || fits(*depth), "depth: expected the images' shape");
    sources::Query query{};
    query.maps.images = images.data();
    query.maps.mattes = mattes.data();
    query.maps.depth = depth ? depth->data() : nullptr;
    query.maps.width = static_cast<int>(width);
    query.maps.height = static_cast<int>(height);
    if (features) {
        require(features->shape(0) == views && features->shape(1) >= 1 && features->shape(1) <= 256 &&
                    features->shape(2) >= 1 && features->shape(3) >= 1 && features->shape(2) <= kLongestSide &&
                    features->shape(3) <= kLongestSide,
                "features: expected 1 to 256 channels, for each view");
        query.maps.features = features->data();
        query.maps.channels = static_cast<int>(features->shape(1));
        query.maps.feature_height = static_cast<int>(features->shape(2));
        query.maps.feature_width = static_cast<int>(features->shape(3));
    }
    query.cameras = cameras.data();
    query.views = static_cast<int>(views);
    query.xyz = xyz.data();
    query.count = xyz.shape(0);
    query.softness = softness;
    return query;
}

template <typename Array>
void require_channels(const Array& array, const sources::Query& query) {
    require(array.shape(0) == static_cast<std::size_t>(query.views) &&
                array.shape(1) == static_cast<std::size_t>(query.maps.channels + 3) && array.shape(2) == query.count,
            "channels: expected shape (views, channels and 3, points)");
}

void sample(const Xyz& xyz, const Images& images, const Grey& mattes, const std::optional<Grey>& depth,
            const std::optional<Features>& features, const std::vector<double>& cameras, float softness,
            std::uintptr_t stream, const ChannelsOut& out_channels, const TrustOut& out_trust) {
    const std::vector<sources::Pinhole> pinholes = cameras_of(cameras, images.shape(0));
    const sources::Query query = query_of(xyz, images, mattes, depth, features, pinholes, softness);
    require_channels(out_channels, query);
    require(out_trust.shape(0) == images.shape(0) && out_trust.shape(1) == query.count, "trust: unexpected shape");
    sources::cuda::sample(query, {out_channels.data(), out_trust.data()}, stream_of(stream));
}

void sample_backward(const Xyz& xyz, const Images& images, const Grey& mattes, const std::optional<Features>& features,
                     const std::vector<double>& cameras, std::uintptr_t stream, const Channels& gradient,
                     const XyzOut& out_xyz, const std::optional<FeaturesOut>& out_features) {
    const std::vector<sources::Pinhole> pinholes = cameras_of(cameras, images.shape(0));
    const sources::Query query = query_of(xyz, images, mattes, std::nullopt, features, pinholes, 1.0f);
    require_channels(gradient, query);
    require(out_xyz.shape(0) == query.count, "out_xyz: unexpected shape");
    if (out_features) {
        require(features.has_value(), "out_features: expected none without features");
        for (std::size_t axis = 0; axis < 4; ++axis) {
            require(out_features->shape(axis) == features->shape(axis), "out_features: expected the features' shape");
        }
    }
    sources::cuda::sample_backward(query, gradient.data(),
                                   {out_xyz.data(), out_features ? out_features->data() : nullptr}, stream_of(stream));
}

}  // namespace

void bind_sources(nb::module_& module) {
    module.def("sample_sources", &sample, nb::arg("xyz"), nb::arg("images"), nb::arg("mattes"), nb::arg("depth").none(),
               nb::arg("features").none(), nb::arg("cameras"), nb::arg("softness"), nb::arg("stream"),
               nb::arg("out_channels"), nb::arg("out_trust"));
    module.def("sample_sources_backward", &sample_backward, nb::arg("xyz"), nb::arg("images"), nb::arg("mattes"),
               nb::arg("features").none(), nb::arg("cameras"), nb::arg("stream"), nb::arg("gradient"),
               nb::arg("out_xyz"), nb::arg("out_features").none());
}

}  // namespace fourd::cuda
