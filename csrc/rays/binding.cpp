// Python bindings of ray tracing; fourd/rendering/ops/rays/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <memory>
#include <string>
#include <tuple>

#include "rays/arguments.h"
#include "rays/discs.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = RayArguments<nb::device::cpu>;
using Rows = nb::ndarray<nb::numpy, float, nb::ndim<2>>;
using NodeRowsOut = Arguments::Array<float, nb::shape<-1, sizeof(rays::Node) / sizeof(float)>>;
using BlockRowsOut = Arguments::Array<float, nb::shape<-1, sizeof(rays::Block) / sizeof(float)>>;
using Flags = Arguments::Array<std::uint8_t, nb::ndim<1>>;

// Returns the nodes or blocks of a buffer as an array of floats with one row for each node or block. The returned array
// owns the memory of the buffer.
template <typename Record>
Rows rows_of(Buffer<Record>&& records) {
    auto owned = std::make_unique<Buffer<Record>>(std::move(records));
    float* const data = reinterpret_cast<float*>(owned->data());
    const std::size_t count = owned->size();
    nb::capsule owner(owned.get(), [](void* buffer) noexcept { delete static_cast<Buffer<Record>*>(buffer); });
    static_cast<void>(owned.release());
    return Rows(data, {count, sizeof(Record) / sizeof(float)}, owner);
}

std::tuple<Rows, Rows, float> build_rays(const Arguments::Positions& xyz, const Arguments::Triangles& tri, int threads) {
    const rays::Mesh mesh = Arguments::mesh(xyz, tri);
    rays::Tree tree;
    {
        nb::gil_scoped_release release;
        tree = rays::build(mesh, clamp_threads(threads));
    }
    const float magnitude = tree.magnitude;
    return {rows_of(std::move(tree.nodes)), rows_of(std::move(tree.blocks)), magnitude};
}

float refit_rays(const Arguments::Positions& xyz, const Arguments::Triangles& tri, int threads, const NodeRowsOut& nodes,
                 const BlockRowsOut& blocks) {
    const rays::Mesh mesh = Arguments::mesh(xyz, tri);
    nb::gil_scoped_release release;
    return rays::refit(mesh, reinterpret_cast<rays::Node*>(nodes.data()), nodes.shape(0),
                       reinterpret_cast<rays::Block*>(blocks.data()), blocks.shape(0), clamp_threads(threads));
}

double rays_cost(const Arguments::NodeRows& nodes, const Arguments::BlockRows& blocks) {
    return rays::expected_cost(Arguments::tree(nodes, blocks, 0.0f));
}

void trace_rays(const Arguments::NodeRows& nodes, const Arguments::BlockRows& blocks, float magnitude,
                const Arguments::Positions& origins, const Arguments::Positions& directions,
                const Arguments::Numbers& t_min, const Arguments::Numbers& t_max,
                const std::optional<Arguments::Numbers>& after_t,
                const std::optional<Arguments::Indices>& after_triangle, int threads, const std::string& simd,
                const Arguments::GridOut& t, const Arguments::GridOut& u, const Arguments::GridOut& v,
                const Arguments::IndexGridOut& triangle) {
    const rays::Rays query = Arguments::rays_of(origins, directions, t_min, t_max, after_t, after_triangle,
                                                clamp_threads(threads), simd_named(simd.c_str()));
    const rays::Hits hits = Arguments::hits(query.count, t, u, v, triangle);
    nb::gil_scoped_release release;
    rays::trace(Arguments::tree(nodes, blocks, magnitude), query, hits);
}

void occluded_rays(const Arguments::NodeRows& nodes, const Arguments::BlockRows& blocks, float magnitude,
                   const Arguments::Positions& origins, const Arguments::Positions& directions,
                   const Arguments::Numbers& t_min, const Arguments::Numbers& t_max, int threads,
                   const std::string& simd, const Flags& out) {
    const rays::Rays query = Arguments::rays_of(origins, directions, t_min, t_max, std::nullopt, std::nullopt,
                                                clamp_threads(threads), simd_named(simd.c_str()));
    require(out.shape(0) == query.count, "out: expected one number for each ray");
    nb::gil_scoped_release release;
    rays::occluded(Arguments::tree(nodes, blocks, magnitude), query, out.data());
}

void trace_rays_backward(const Arguments::Positions& xyz, const Arguments::Triangles& tri,
                         const Arguments::Positions& origins, const Arguments::Positions& directions,
                         const Arguments::Grid& t, const Arguments::Grid& u, const Arguments::Grid& v,
                         const Arguments::IndexGrid& triangle, const Arguments::Grid& to_t, const Arguments::Grid& to_u,
                         const Arguments::Grid& to_v, int threads, const Arguments::PositionsOut& to_xyz,
                         const Arguments::PositionsOut& to_origins, const Arguments::PositionsOut& to_directions) {
    const rays::Mesh mesh = Arguments::mesh(xyz, tri);
    const rays::HitGradients gradients =
        Arguments::gradients(xyz, origins, directions, t, u, v, triangle, to_t, to_u, to_v, clamp_threads(threads),
                             to_xyz, to_origins, to_directions);
    nb::gil_scoped_release release;
    rays::trace_backward(mesh, gradients);
}

std::tuple<Rows, Rows, float> build_discs(const Arguments::Positions& xyz, const Arguments::Numbers& radius,
                                          const Arguments::Numbers& density, int threads) {
    require(xyz.shape(0) <= 0x7fffffff, "xyz: expected at most 2^31 - 1 discs");
    require(radius.shape(0) == xyz.shape(0) && density.shape(0) == xyz.shape(0), "radius: expected one for each disc");
    rays::DiscTree tree;
    {
        nb::gil_scoped_release release;
        tree = rays::build_discs({xyz.data(), radius.data(), density.data(), xyz.shape(0)}, clamp_threads(threads));
    }
    const float magnitude = tree.magnitude;
    return {rows_of(std::move(tree.nodes)), rows_of(std::move(tree.blocks)), magnitude};
}

void composite_discs(const Arguments::NodeRows& nodes, const Arguments::DiscRows& blocks, float magnitude,
                     const Arguments::Positions& colours, const Arguments::Positions& origins,
                     const Arguments::Positions& directions, const Arguments::Numbers& t_min,
                     const Arguments::Numbers& t_max, const std::optional<Arguments::Vector>& facing, int layers,
                     int threads, const std::string& simd, const Arguments::PictureOut& out) {
    const rays::Rays query = Arguments::rays_of(origins, directions, t_min, t_max, std::nullopt, std::nullopt,
                                                clamp_threads(threads), simd_named(simd.c_str()));
    const rays::DiscPicture picture = Arguments::picture(query.count, colours, facing, layers, out);
    nb::gil_scoped_release release;
    rays::composite_discs(Arguments::discs(nodes, blocks, magnitude), query, picture);
}

}  // namespace

void bind_rays(nb::module_& module) {
    module.def("build_rays", &build_rays, nb::arg("xyz"), nb::arg("tri"), nb::arg("threads"),
               "Sizes: xyz=V tri=T tri<V");
    module.def("refit_rays", &refit_rays, nb::arg("xyz"), nb::arg("tri"), nb::arg("threads"), nb::arg("nodes"),
               nb::arg("blocks"),
               "Sizes: xyz=V tri=T tri<V");
    module.def("rays_cost", &rays_cost, nb::arg("nodes"), nb::arg("blocks"),
               "Sizes:");
    module.def("trace_rays", &trace_rays, nb::arg("nodes"), nb::arg("blocks"), nb::arg("magnitude"), nb::arg("origins"),
               nb::arg("directions"), nb::arg("t_min"), nb::arg("t_max"), nb::arg("after_t").none(),
               nb::arg("after_triangle").none(), nb::arg("threads"), nb::arg("simd"), nb::arg("t"), nb::arg("u"),
               nb::arg("v"), nb::arg("triangle"),
               "Sizes: origins=N directions=N t_min=1 t_max=N after_t=N after_triangle=N after_triangle<T t=N,L "
               "u=N,L v=N,L triangle=N,L\n"
               "Sizes: origins=N directions=N t_min=N t_max=1 after_t=N after_triangle=N after_triangle<T t=N,L "
               "u=N,L v=N,L triangle=N,L");
    module.def("occluded_rays", &occluded_rays, nb::arg("nodes"), nb::arg("blocks"), nb::arg("magnitude"),
               nb::arg("origins"), nb::arg("directions"), nb::arg("t_min"), nb::arg("t_max"), nb::arg("threads"),
               nb::arg("simd"), nb::arg("out"),
               "Sizes: origins=N directions=N t_min=1 t_max=N out=N");
    module.def("trace_rays_backward", &trace_rays_backward, nb::arg("xyz"), nb::arg("tri"), nb::arg("origins"),
               nb::arg("directions"), nb::arg("t"), nb::arg("u"), nb::arg("v"), nb::arg("triangle"), nb::arg("to_t"),
               nb::arg("to_u"), nb::arg("to_v"), nb::arg("threads"), nb::arg("to_xyz"), nb::arg("to_origins"),
               nb::arg("to_directions"),
               "Sizes: xyz=V tri=T tri<V origins=N directions=N t=N,L u=N,L v=N,L triangle=N,L triangle<T to_t=N,L "
               "to_u=N,L to_v=N,L to_xyz=V to_origins=N to_directions=N");
    module.def("build_discs", &build_discs, nb::arg("xyz"), nb::arg("radius"), nb::arg("density"), nb::arg("threads"),
               "Sizes: xyz=D radius=D density=D");
    module.def("composite_discs", &composite_discs, nb::arg("nodes"), nb::arg("blocks"), nb::arg("magnitude"),
               nb::arg("colours"), nb::arg("origins"), nb::arg("directions"), nb::arg("t_min"), nb::arg("t_max"),
               nb::arg("facing").none(), nb::arg("layers"), nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               "Sizes: colours=D origins=N directions=N t_min=1 t_max=N out=N");
}

}  // namespace fourd
