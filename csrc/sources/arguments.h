// Checks and converts the arguments of the kernels that sample source views, for the CPU and a GPU.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>
#include <vector>

#include "binding/require.h"
#include "sources/sources.h"

namespace fourd {

template <typename Device>
struct SourceArguments {
    template <typename Number, typename Shape>
    using Array = nanobind::ndarray<Number, Shape, nanobind::c_contig, Device>;
    using Xyz = Array<const float, nanobind::shape<-1, 3>>;
    using XyzOut = Array<float, nanobind::shape<-1, 3>>;
    using Images = Array<const float, nanobind::shape<-1, 3, -1, -1>>;
    using Features = Array<const float, nanobind::ndim<4>>;  // Shape (views, height, width, channels)
    using FeaturesOut = Array<float, nanobind::ndim<4>>;
    using Grey = Array<const float, nanobind::ndim<3>>;
    using Channels = Array<const float, nanobind::ndim<3>>;
    using ChannelsOut = Array<float, nanobind::ndim<3>>;
    using VisibilityOut = Array<float, nanobind::ndim<2>>;
    using Softness = Array<const float, nanobind::ndim<1>>;

    // Numbers per camera: the matrices K and R, both row-major, and the vector T.
    static constexpr std::size_t kNumbers = 21;
    static constexpr std::size_t kMaxViews = 1 << 16;
    static constexpr std::size_t kMaxChannels = 256;
    static constexpr std::size_t kLongestSide = 1 << 24;

    std::vector<sources::Pinhole> cameras;
    sources::Query query{};

    SourceArguments(const Xyz& xyz, const Images& images, const Grey& mattes, const std::optional<Grey>& depth,
                    const std::optional<Features>& features, const std::vector<double>& numbers,
                    const Softness* softness, int threads, Simd simd)
        : cameras(cameras_of(numbers, images.shape(0))) {
        const std::size_t height = images.shape(2), width = images.shape(3);
        require(xyz.shape(0) <= 0x7fffffff, "xyz: expected at most 2^31 - 1 points");
        require(height >= 1 && width >= 1 && height <= kLongestSide && width <= kLongestSide,
                "images: expected sides from 1 to 2^24");
        require(!softness || softness->shape(0) == xyz.shape(0), "softness: expected one value per point");
        require(fits(mattes, images), "mattes: expected the images' shape");
        require(!depth || fits(*depth, images), "depth: expected the images' shape");
        query.maps.images = images.data();
        query.maps.mattes = mattes.data();
        query.maps.depth = depth ? depth->data() : nullptr;
        query.maps.width = static_cast<int>(width);
        query.maps.height = static_cast<int>(height);
        if (features) take_features(*features);
        query.cameras = cameras.data();
        query.views = static_cast<int>(cameras.size());
        query.xyz = xyz.data();
        query.count = xyz.shape(0);
        query.softness = softness ? softness->data() : nullptr;
        query.threads = threads;
        query.simd = simd;
    }

    sources::Samples samples(const ChannelsOut& channels, const VisibilityOut& visibility) const {
        require_channels(channels);
        require(visibility.shape(0) == cameras.size() && visibility.shape(1) == query.count,
                "out_visibility: expected shape (views, points)");
        return {channels.data(), visibility.data()};
    }

    const float* gradient(const Channels& channels) const {
        require_channels(channels);
        return channels.data();
    }

    sources::Gradients gradients(const XyzOut& xyz, const std::optional<FeaturesOut>& features) const {
        require(xyz.shape(0) == query.count, "out_xyz: unexpected shape");
        if (!features) return {xyz.data(), nullptr};
        const sources::Maps& maps = query.maps;
        require(maps.channels > 0 && features->shape(0) == cameras.size() &&
                    features->shape(1) == static_cast<std::size_t>(maps.feature_height) &&
                    features->shape(2) == static_cast<std::size_t>(maps.feature_width) &&
                    features->shape(3) == static_cast<std::size_t>(maps.channels),
                "out_features: expected the features' shape");
        return {xyz.data(), features->data()};
    }

  private:
    static std::vector<sources::Pinhole> cameras_of(const std::vector<double>& numbers, std::size_t views) {
        require(views >= 1 && views <= kMaxViews, "images: expected 1 to 2^16 views");
        require(numbers.size() == kNumbers * views, "cameras: expected 21 numbers per view");
        std::vector<sources::Pinhole> out(views);
        for (std::size_t view = 0; view < views; ++view) {
            const double* from = numbers.data() + kNumbers * view;
            for (int i = 0; i < 9; ++i) out[view].intrinsics[i] = static_cast<float>(from[i]);
            for (int i = 0; i < 9; ++i) out[view].rotation[i] = static_cast<float>(from[9 + i]);
            for (int i = 0; i < 3; ++i) out[view].translation[i] = static_cast<float>(from[18 + i]);
        }
        return out;
    }

    static bool fits(const Grey& grey, const Images& images) {
        return grey.shape(0) == images.shape(0) && grey.shape(1) == images.shape(2) && grey.shape(2) == images.shape(3);
    }

    void take_features(const Features& features) {
        require(features.shape(0) == cameras.size() && features.shape(1) >= 1 && features.shape(2) >= 1 &&
                    features.shape(1) <= kLongestSide && features.shape(2) <= kLongestSide,
                "features: expected (views, height, width, channels)");
        require(features.shape(3) >= 1 && features.shape(3) <= kMaxChannels, "features: expected 1 to 256 channels");
        query.maps.features = features.data();
        query.maps.feature_height = static_cast<int>(features.shape(1));
        query.maps.feature_width = static_cast<int>(features.shape(2));
        query.maps.channels = static_cast<int>(features.shape(3));
    }

    template <typename Array>
    void require_channels(const Array& array) const {
        require(array.shape(0) == cameras.size() &&
                    array.shape(1) == static_cast<std::size_t>(query.maps.channels + 3) &&
                    array.shape(2) == query.count,
                "channels: expected shape (views, channels and 3, points)");
    }
};

}  // namespace fourd
