// Checks and converts the arguments of triangle splatting, for the CPU and a GPU. This file checks the shapes of
// arrays, and it checks vertex indices in CPU memory. Without these checks, a kernel could access memory out of bounds.
// fourd/rendering/triangles/splatting.py checks the values of all arguments, including vertex indices in GPU memory.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>
#include <string>
#include <vector>

#include "binding/indices.h"
#include "points/arguments.h"
#include "splat_triangles/splat_triangles.h"

namespace fourd {

inline splat_triangles::Settings splat_settings(const std::vector<double>& camera, std::size_t width,
                                                std::size_t height, int layers, double near_depth, int threads,
                                                const std::string& simd) {
    require(layers <= 1 << 20, "layers: out of range");
    const points::Settings same = points_settings(camera, width, height, layers, near_depth, 0.0, threads, simd);
    return {same.camera, same.near_depth, same.layers, same.threads, same.simd};
}

template <typename Device>
struct SplatArguments {
    template <typename Number, std::size_t Axes>
    using Array = nanobind::ndarray<Number, nanobind::ndim<Axes>, nanobind::c_contig, Device>;
    using Xyz = nanobind::ndarray<const float, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using XyzOut = nanobind::ndarray<float, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using Triangles = nanobind::ndarray<const std::int32_t, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using Column = Array<const float, 1>;
    using ColumnOut = Array<float, 1>;
    using Rows = Array<const float, 2>;
    using RowsOut = Array<float, 2>;
    using Picture = Array<const float, 3>;
    using PictureOut = Array<float, 3>;

    static splat_triangles::Mesh mesh(const Xyz& xyz, const Triangles& tri, const Rows& features, const Column& opacity,
                                      const Column& sigma, bool geometry) {
        const std::size_t count = tri.shape(0), channels = features.shape(1);
        require(count <= 0x7fffffff && xyz.shape(0) <= 0x7fffffff, "xyz, tri: expected at most 2^31 - 1 rows");
        require(count == 0 || xyz.shape(0) > 0, "xyz: expected at least one vertex");
        require_indices(tri, xyz.shape(0), "tri: expected indices of vertices");
        require(features.shape(0) == count && channels >= (geometry ? 1 + splat_triangles::kGeometry : 1) &&
                    channels <= splat_triangles::kMaxChannels,
                "features: unexpected shape");
        require(opacity.shape(0) == count && sigma.shape(0) == count, "opacity, sigma: unexpected shape");
        return {xyz.data(),   tri.data(), features.data(), opacity.data(),
                sigma.data(), xyz.shape(0), count, static_cast<int>(channels), geometry};
    }

    // If `geometry` is false, the arrays `normal` and `depth` are not used and may have any shape.
    static splat_triangles::Image image(const splat_triangles::Mesh& mesh, const PictureOut& features,
                                        const RowsOut& alpha, const RowsOut& transmittance, const PictureOut& normal,
                                        const RowsOut& depth) {
        require_sizes(mesh, features, alpha, normal, depth);
        require_size(transmittance, alpha);
        return {features.data(), alpha.data(), transmittance.data(), mesh.geometry ? normal.data() : nullptr,
                mesh.geometry ? depth.data() : nullptr};
    }

    static splat_triangles::ImageGradient gradient(const splat_triangles::Mesh& mesh, const Picture& features,
                                                   const Rows& alpha, const Picture& normal, const Rows& depth,
                                                   const splat_triangles::Image& rendered) {
        require_sizes(mesh, features, alpha, normal, depth);
        return {features.data(), alpha.data(), mesh.geometry ? normal.data() : nullptr,
                mesh.geometry ? depth.data() : nullptr, rendered};
    }

    static splat_triangles::MeshGradient mesh_gradient(const splat_triangles::Mesh& mesh, const XyzOut& xyz,
                                                       const RowsOut& features, const ColumnOut& opacity,
                                                       const ColumnOut& sigma) {
        require(xyz.shape(0) == mesh.vertices && opacity.shape(0) == mesh.count && sigma.shape(0) == mesh.count &&
                    features.shape(0) == mesh.count && features.shape(1) == static_cast<std::size_t>(mesh.channels),
                "out_xyz, out_features, out_opacity, out_sigma: unexpected shape");
        return {xyz.data(), features.data(), opacity.data(), sigma.data()};
    }

  private:
    template <typename Three, typename Two>
    static void require_sizes(const splat_triangles::Mesh& mesh, const Three& features, const Two& alpha,
                              const Three& normal, const Two& depth) {
        require_size(features, alpha);
        const int channels = mesh.channels - (mesh.geometry ? splat_triangles::kGeometry : 0);
        require(features.shape(2) == static_cast<std::size_t>(channels), "features of the image: unexpected shape");
        if (!mesh.geometry) return;
        require_size(normal, alpha);
        require_size(depth, alpha);
        require(normal.shape(2) == 3, "normal: unexpected shape");
    }

    template <typename One, typename Other>
    static void require_size(const One& one, const Other& other) {
        require(one.shape(0) == other.shape(0) && one.shape(1) == other.shape(1), "images: expected equal sizes");
    }
};

}  // namespace fourd
