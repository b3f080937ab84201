// Checks and converts the arguments of the point renderer, for the CPU and a GPU. fourd/rendering/ops/points/validation.py checks
// the values of the arguments. This file checks the shapes of arrays, because a kernel would read past the end of an
// array that is too small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>
#include <string>
#include <vector>

#include "binding/require.h"
#include "points/points.h"

namespace fourd {

// Returns the settings of the point renderer. `camera` has 21 numbers: the intrinsics K (3 x 3) and the rotation R
// (3 x 3), both row-major, and the translation T (3,). Throws std::invalid_argument if `camera` does not have 21
// numbers, if `width`, `height`, `layers`, `near_depth` or `threads` is out of range, or if this machine does not
// support the instruction set `simd`.
inline points::Settings points_settings(const std::vector<double>& camera, std::size_t width, std::size_t height,
                                        int layers, double near_depth, double transmittance_min, int threads,
                                        const std::string& simd) {
    constexpr std::size_t kLongest = points::kLongestSide;
    const bool sized = width >= 1 && height >= 1 && width <= kLongest && height <= kLongest;
    require(camera.size() == 21 && sized && layers >= 1 && near_depth > 0 && threads >= 1,
            "camera, width, height, layers, near, threads: out of range");
    points::Settings settings;
    for (int i = 0; i < 9; ++i) settings.camera.intrinsics[i] = static_cast<float>(camera[i]);
    for (int i = 0; i < 9; ++i) settings.camera.rotation[i] = static_cast<float>(camera[9 + i]);
    for (int i = 0; i < 3; ++i) settings.camera.translation[i] = static_cast<float>(camera[18 + i]);
    settings.camera.width = static_cast<int>(width);
    settings.camera.height = static_cast<int>(height);
    settings.near_depth = static_cast<float>(near_depth);
    settings.layers = layers;
    settings.transmittance_min = static_cast<float>(transmittance_min);
    settings.threads = clamp_threads(threads);
    settings.simd = simd_named(simd.c_str());
    return settings;
}

template <typename Device>
struct PointArguments {
    template <typename Number, std::size_t Axes>
    using Array = nanobind::ndarray<Number, nanobind::ndim<Axes>, nanobind::c_contig, Device>;
    using Xyz = nanobind::ndarray<const float, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using XyzOut = nanobind::ndarray<float, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using Column = Array<const float, 1>;
    using ColumnOut = Array<float, 1>;
    using Rows = Array<const float, 2>;
    using RowsOut = Array<float, 2>;
    using Picture = Array<const float, 3>;
    using PictureOut = Array<float, 3>;

    static points::Cloud cloud(const Xyz& xyz, const Rows& features, const Column& radius, const Column& density) {
        points::Cloud out = bare_cloud(xyz, radius, density);
        require(features.shape(0) == out.count && features.shape(1) >= 1 && features.shape(1) <= 32,
                "features: unexpected shape");
        out.features = features.data();
        out.channels = static_cast<int>(features.shape(1));
        return out;
    }

    // Makes a cloud without features.
    static points::Cloud bare_cloud(const Xyz& xyz, const Column& radius, const Column& density) {
        const std::size_t count = xyz.shape(0);
        require(count <= 0x7fffffff, "xyz: expected at most 2^31 - 1 points");
        require(radius.shape(0) == count && density.shape(0) == count, "radius, density: unexpected shape");
        return {xyz.data(), nullptr, radius.data(), density.data(), count, 0};
    }

    static points::Image image(const points::Cloud& cloud, const PictureOut& features, const RowsOut& alpha,
                               const RowsOut& depth) {
        require_size(features, alpha, "out_features: unexpected shape");
        require_size(depth, alpha, "out_depth: unexpected shape");
        require(features.shape(2) == static_cast<std::size_t>(cloud.channels), "out_features: unexpected shape");
        return {features.data(), alpha.data(), depth.data()};
    }

    static points::ImageGradient image_gradient(const points::Cloud& cloud, const Picture& features, const Rows& alpha,
                                                const std::optional<Rows>& depth) {
        require_size(features, alpha, "grad_features: unexpected shape");
        require(features.shape(2) == static_cast<std::size_t>(cloud.channels), "grad_features: unexpected shape");
        if (depth) require_size(*depth, alpha, "grad_depth: unexpected shape");
        return {features.data(), alpha.data(), depth ? depth->data() : nullptr};
    }

    static points::CloudGradient cloud_gradient(const points::Cloud& cloud, const XyzOut& xyz, const RowsOut& features,
                                                const ColumnOut& radius, const ColumnOut& density) {
        require(xyz.shape(0) == cloud.count && radius.shape(0) == cloud.count && density.shape(0) == cloud.count,
                "out_xyz, out_radius, out_density: unexpected shape");
        require(features.shape(0) == cloud.count && features.shape(1) == static_cast<std::size_t>(cloud.channels),
                "out_features: unexpected shape");
        return {xyz.data(), features.data(), radius.data(), density.data()};
    }

  private:
    template <typename One, typename Other>
    static void require_size(const One& one, const Other& other, const char* message) {
        require(one.shape(0) == other.shape(0) && one.shape(1) == other.shape(1), message);
    }
};

}  // namespace fourd
