// Python bindings of ray tracing on a GPU; fourd/rendering/ops/rays/op.py documents the operations.
#include <nanobind/stl/optional.h>

#include "binding/cuda_arrays.h"
#include "rays/arguments.h"
#include "rays/cuda/discs.h"
#include "rays/cuda/trace.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = RayArguments<Where>;
using Flags = Arguments::Array<std::uint8_t, nb::ndim<1>>;

void trace_rays(const Arguments::NodeRows& nodes, const Arguments::BlockRows& blocks, float magnitude,
                const Arguments::Positions& origins, const Arguments::Positions& directions,
                const Arguments::Numbers& t_min, const Arguments::Numbers& t_max,
                const std::optional<Arguments::Numbers>& after_t,
                const std::optional<Arguments::Indices>& after_triangle, std::uintptr_t stream,
                const Arguments::GridOut& t, const Arguments::GridOut& u, const Arguments::GridOut& v,
                const Arguments::IndexGridOut& triangle) {
    const rays::Rays query =
        Arguments::rays_of(origins, directions, t_min, t_max, after_t, after_triangle, 1, Simd::baseline);
    rays::cuda::trace(Arguments::tree(nodes, blocks, magnitude), query, Arguments::hits(query.count, t, u, v, triangle),
                      stream_of(stream));
}

void occluded_rays(const Arguments::NodeRows& nodes, const Arguments::BlockRows& blocks, float magnitude,
                   const Arguments::Positions& origins, const Arguments::Positions& directions,
                   const Arguments::Numbers& t_min, const Arguments::Numbers& t_max, std::uintptr_t stream,
                   const Flags& out) {
    const rays::Rays query =
        Arguments::rays_of(origins, directions, t_min, t_max, std::nullopt, std::nullopt, 1, Simd::baseline);
    require(out.shape(0) == query.count, "out: expected one number for each ray");
    rays::cuda::occluded(Arguments::tree(nodes, blocks, magnitude), query, out.data(), stream_of(stream));
}

void trace_rays_backward(const Arguments::Positions& xyz, const Arguments::Triangles& tri,
                         const Arguments::Positions& origins, const Arguments::Positions& directions,
                         const Arguments::Grid& t, const Arguments::Grid& u, const Arguments::Grid& v,
                         const Arguments::IndexGrid& triangle, const Arguments::Grid& to_t, const Arguments::Grid& to_u,
                         const Arguments::Grid& to_v, std::uintptr_t stream, const Arguments::PositionsOut& to_xyz,
                         const Arguments::PositionsOut& to_origins, const Arguments::PositionsOut& to_directions) {
    rays::cuda::trace_backward(Arguments::mesh(xyz, tri),
                               Arguments::gradients(xyz, origins, directions, t, u, v, triangle, to_t, to_u, to_v, 1,
                                                    to_xyz, to_origins, to_directions),
                               stream_of(stream));
}

void composite_discs(const Arguments::NodeRows& nodes, const Arguments::DiscRows& blocks, float magnitude,
                     const Arguments::Positions& colours, const Arguments::Positions& origins,
                     const Arguments::Positions& directions, const Arguments::Numbers& t_min,
                     const Arguments::Numbers& t_max, const std::optional<Arguments::Vector>& facing, int layers,
                     std::uintptr_t stream, const Arguments::PictureOut& out) {
    const rays::Rays query =
        Arguments::rays_of(origins, directions, t_min, t_max, std::nullopt, std::nullopt, 1, Simd::baseline);
    rays::cuda::composite_discs(Arguments::discs(nodes, blocks, magnitude), query,
                                Arguments::picture(query.count, colours, facing, layers, out), stream_of(stream));
}

}  // namespace

void bind_rays(nb::module_& module) {
    module.def("trace_rays", &trace_rays, nb::arg("nodes"), nb::arg("blocks"), nb::arg("magnitude"), nb::arg("origins"),
               nb::arg("directions"), nb::arg("t_min"), nb::arg("t_max"), nb::arg("after_t").none(),
               nb::arg("after_triangle").none(), nb::arg("stream"), nb::arg("t"), nb::arg("u"), nb::arg("v"),
               nb::arg("triangle"));
    module.def("occluded_rays", &occluded_rays, nb::arg("nodes"), nb::arg("blocks"), nb::arg("magnitude"),
               nb::arg("origins"), nb::arg("directions"), nb::arg("t_min"), nb::arg("t_max"), nb::arg("stream"),
               nb::arg("out"));
    module.def("trace_rays_backward", &trace_rays_backward, nb::arg("xyz"), nb::arg("tri"), nb::arg("origins"),
               nb::arg("directions"), nb::arg("t"), nb::arg("u"), nb::arg("v"), nb::arg("triangle"), nb::arg("to_t"),
               nb::arg("to_u"), nb::arg("to_v"), nb::arg("stream"), nb::arg("to_xyz"), nb::arg("to_origins"),
               nb::arg("to_directions"));
    module.def("composite_discs", &composite_discs, nb::arg("nodes"), nb::arg("blocks"), nb::arg("magnitude"),
               nb::arg("colours"), nb::arg("origins"), nb::arg("directions"), nb::arg("t_min"), nb::arg("t_max"),
               nb::arg("facing").none(), nb::arg("layers"), nb::arg("stream"), nb::arg("out"));
}

}  // namespace fourd::cuda
