// Checks and converts the arguments of soft rasterization, for the CPU and a GPU. This file checks the shapes of
// arrays, and it checks vertex indices in CPU memory. Without these checks, a kernel could access memory out of bounds.
// fourd/rendering/triangles/soft.py checks the values of all arguments, including vertex indices in GPU memory.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <string>
#include <vector>

#include "binding/indices.h"
#include "points/arguments.h"
#include "soft_triangles/soft_triangles.h"

namespace fourd {

// Returns the settings of soft rasterization. `camera` is the same as for points_settings (points/arguments.h).
// `softness` has 7 numbers. The first is 1 for barycentric distances, and 0 for Euclidean distances. The others are
// the arguments sigma, gamma, cutoff, near, far and eps of rasterize_soft (fourd/rendering/triangles/soft.py).
inline soft_triangles::Settings soft_settings(const std::vector<double>& camera, std::size_t width, std::size_t height,
                                              const std::vector<double>& softness, int layers, int threads,
                                              const std::string& simd) {
    require(softness.size() == 7 && layers <= 1 << 20, "softness, layers: out of range");
    const double sigma = softness[1], gamma = softness[2], cutoff = softness[3], near = softness[4],
                 far = softness[5], eps = softness[6];
    require(sigma > 0 && gamma > 0 && cutoff > 0 && cutoff < 0.5 && far > near, "softness: out of range");
    const points::Settings same = points_settings(camera, width, height, layers, near, 0.0, threads, simd);
    soft_triangles::Settings out{same.camera, {}, same.near_depth, same.layers, same.threads, same.simd};
    const bool barycentric = softness[0] != 0;
    const double pixel = 2.0 / static_cast<double>(width < height ? width : height);
    const double sharpness = (barycentric ? 1.0 : pixel * pixel) / sigma, cut = std::log(1.0 / cutoff - 1.0);
    out.softness.barycentric = barycentric;
    out.softness.sharpness = static_cast<float>(sharpness);
    out.softness.cut = static_cast<float>(cut);
    out.softness.reach = static_cast<float>(std::sqrt(cut / sharpness));
    out.softness.per_depth = static_cast<float>(1.0 / ((far - near) * gamma));
    out.softness.far_depth = static_cast<float>(far);
    out.softness.background_depth = static_cast<float>(far - eps * (far - near));
    return out;
}

template <typename Device>
struct SoftArguments {
    template <typename Number, std::size_t Axes>
    using Array = nanobind::ndarray<Number, nanobind::ndim<Axes>, nanobind::c_contig, Device>;
    using Xyz = nanobind::ndarray<const float, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using XyzOut = nanobind::ndarray<float, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using Triangles = nanobind::ndarray<const std::int32_t, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;
    using Rows = Array<const float, 2>;
    using RowsOut = Array<float, 2>;
    using Picture = Array<const float, 3>;
    using PictureOut = Array<float, 3>;

    static soft_triangles::Mesh mesh(const Xyz& xyz, const Triangles& tri, const Rows& features) {
        const std::size_t count = tri.shape(0), channels = features.shape(1);
        require(count <= 0x7fffffff && xyz.shape(0) <= 0x7fffffff, "xyz, tri: expected at most 2^31 - 1 rows");
        require(count == 0 || xyz.shape(0) > 0, "xyz: expected at least one vertex");
        require_indices(tri, xyz.shape(0), "tri: expected indices of vertices");
        require(features.shape(0) == count && channels >= 1 && channels <= soft_triangles::kMaxChannels,
                "features: unexpected shape");
        return {xyz.data(), tri.data(), features.data(), xyz.shape(0), count, static_cast<int>(channels)};
    }

    static soft_triangles::Image image(const soft_triangles::Mesh& mesh, const PictureOut& features,
                                       const RowsOut& alpha) {
        require_sizes(mesh, features, alpha);
        return {features.data(), alpha.data()};
    }

    static soft_triangles::ImageGradient gradient(const soft_triangles::Mesh& mesh, const Picture& features,
                                                  const Rows& alpha) {
        require_sizes(mesh, features, alpha);
        return {features.data(), alpha.data()};
    }

    static soft_triangles::MeshGradient mesh_gradient(const soft_triangles::Mesh& mesh, const XyzOut& xyz,
                                                      const RowsOut& features) {
        require(xyz.shape(0) == mesh.vertices && features.shape(0) == mesh.count &&
                    features.shape(1) == static_cast<std::size_t>(mesh.channels),
                "out_xyz, out_features: unexpected shape");
        return {xyz.data(), features.data()};
    }

  private:
    template <typename Three, typename Two>
    static void require_sizes(const soft_triangles::Mesh& mesh, const Three& features, const Two& alpha) {
        require(features.shape(0) == alpha.shape(0) && features.shape(1) == alpha.shape(1) &&
                    features.shape(2) == static_cast<std::size_t>(mesh.channels),
                "features of the image: unexpected shape");
    }
};

}  // namespace fourd
