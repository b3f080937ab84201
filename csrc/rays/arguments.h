// Checks and converts the arguments of ray tracing, for the CPU and a GPU. fourd/rendering/ops/rays/op.py checks the values of
// the arguments. This file checks the shapes of arrays, because a kernel would read past the end of an array that is
// too small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>

#include "binding/require.h"
#include "rays/discs.h"
#include "rays/rays.h"

namespace fourd {

template <typename Where>
struct RayArguments {
    template <typename Number, typename... Shape>
    using Array = nanobind::ndarray<Number, Shape..., nanobind::c_contig, Where>;
    using Positions = Array<const float, nanobind::shape<-1, 3>>;
    using Triangles = Array<const std::int32_t, nanobind::shape<-1, 3>>;
    using Numbers = Array<const float, nanobind::ndim<1>>;
    using Indices = Array<const std::int32_t, nanobind::ndim<1>>;
    using Grid = Array<const float, nanobind::ndim<2>>;
    using GridOut = Array<float, nanobind::ndim<2>>;
    using IndexGrid = Array<const std::int32_t, nanobind::ndim<2>>;
    using IndexGridOut = Array<std::int32_t, nanobind::ndim<2>>;
    using PositionsOut = Array<float, nanobind::shape<-1, 3>>;
    // The bindings receive the nodes and blocks of a tree as rows of floats.
    using NodeRows = Array<const float, nanobind::shape<-1, sizeof(rays::Node) / sizeof(float)>>;
    using BlockRows = Array<const float, nanobind::shape<-1, sizeof(rays::Block) / sizeof(float)>>;
    using DiscRows = Array<const float, nanobind::shape<-1, sizeof(rays::DiscBlock) / sizeof(float)>>;
    using Vector = Array<const float, nanobind::shape<3>>;
    using PictureOut = Array<float, nanobind::shape<-1, 4>>;

    static rays::Mesh mesh(const Positions& xyz, const Triangles& tri) {
        require(xyz.shape(0) <= 0x7fffffff && tri.shape(0) <= 0x7fffffff, "tri: expected at most 2^31 - 1 triangles");
        return {xyz.data(), xyz.shape(0), tri.data(), tri.shape(0)};
    }

    static rays::TreeView tree(const NodeRows& nodes, const BlockRows& blocks, float magnitude) {
        return {reinterpret_cast<const rays::Node*>(nodes.data()), nodes.shape(0),
                reinterpret_cast<const rays::Block*>(blocks.data()), blocks.shape(0), magnitude};
    }

    static rays::DiscTreeView discs(const NodeRows& nodes, const DiscRows& blocks, float magnitude) {
        return {reinterpret_cast<const rays::Node*>(nodes.data()), nodes.shape(0),
                reinterpret_cast<const rays::DiscBlock*>(blocks.data()), magnitude};
    }

    // Callers must check that `colours` has one colour for each disc from which the tree was built.
    static rays::DiscPicture picture(std::size_t count, const Positions& colours, const std::optional<Vector>& facing,
                                     int layers, const PictureOut& out) {
        require(layers >= 1 && layers <= rays::kMaxDiscLayers, "layers: expected 1 to 64");
        require(out.shape(0) == count, "out: expected one colour for each ray");
        return {colours.data(), facing ? facing->data() : nullptr, layers, out.data()};
    }

    static rays::Rays rays_of(const Positions& origins, const Positions& directions, const Numbers& t_min,
                              const Numbers& t_max, const std::optional<Numbers>& after_t,
                              const std::optional<Indices>& after_triangle, int threads, Simd simd) {
        const std::size_t count = origins.shape(0);
        require(directions.shape(0) == count, "directions: expected one for each origin");
        require(t_min.shape(0) == count || t_min.shape(0) == 1, "t_min: expected one number, or one for each ray");
        require(t_max.shape(0) == count || t_max.shape(0) == 1, "t_max: expected one number, or one for each ray");
        require(after_t.has_value() == after_triangle.has_value(), "after: expected both t and triangle, or neither");
        require(!after_t || (after_t->shape(0) == count && after_triangle->shape(0) == count),
                "after: expected one hit for each ray");
        return {origins.data(),
                directions.data(),
                count,
                t_min.data(),
                t_min.shape(0) == count ? std::size_t{1} : std::size_t{0},
                t_max.data(),
                t_max.shape(0) == count ? std::size_t{1} : std::size_t{0},
                after_t ? after_t->data() : nullptr,
                after_triangle ? after_triangle->data() : nullptr,
                threads,
                simd};
    }

    static rays::Hits hits(std::size_t count, const GridOut& t, const GridOut& u, const GridOut& v,
                           const IndexGridOut& triangle) {
        const std::size_t layers = layers_of(t);
        for (const GridOut* const array : {&t, &u, &v}) {
            require(array->shape(0) == count && array->shape(1) == layers, "hits: unexpected shape");
        }
        require(triangle.shape(0) == count && triangle.shape(1) == layers, "triangle: unexpected shape");
        return {static_cast<int>(layers), t.data(), u.data(), v.data(), triangle.data()};
    }

    static rays::HitGradients gradients(const Positions& xyz, const Positions& origins, const Positions& directions,
                                        const Grid& t, const Grid& u, const Grid& v, const IndexGrid& triangle,
                                        const Grid& to_t, const Grid& to_u, const Grid& to_v, int threads,
                                        const PositionsOut& to_xyz, const PositionsOut& to_origins,
                                        const PositionsOut& to_directions) {
        const std::size_t count = origins.shape(0), layers = layers_of(t);
        require(directions.shape(0) == count && to_origins.shape(0) == count && to_directions.shape(0) == count &&
                    to_xyz.shape(0) == xyz.shape(0),
                "gradients: unexpected shape");
        for (const Grid* const array : {&t, &u, &v, &to_t, &to_u, &to_v}) {
            require(array->shape(0) == count && array->shape(1) == layers, "hits: unexpected shape");
        }
        require(triangle.shape(0) == count && triangle.shape(1) == layers, "triangle: unexpected shape");
        return {origins.data(), directions.data(), count, static_cast<int>(layers), t.data(), u.data(), v.data(),
                triangle.data(), to_t.data(), to_u.data(), to_v.data(), to_xyz.data(), to_origins.data(),
                to_directions.data(), threads};
    }

  private:
    template <typename Hits>
    static std::size_t layers_of(const Hits& t) {
        require(t.shape(1) >= 1 && t.shape(1) <= 1 << 20, "layers: expected 1 to 2^20");
        return t.shape(1);
    }
};

}  // namespace fourd
