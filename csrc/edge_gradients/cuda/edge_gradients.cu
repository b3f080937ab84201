#include "edge_gradients/cuda/edge_gradients.h"

#include "antialias/cuda/places.h"
#include "device/arena.h"
#include "device/clear.h"
#include "device/executor.h"
#include "edge_gradients/pairs.h"

namespace fourd::edge_gradients::cuda {
namespace {

using antialias::cuda::FindSilhouettes;
using antialias::cuda::instances_of;
using antialias::cuda::Place;

struct MoveEdges {
    Plan plan;
    const float* gradient;
    float* positions;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(plan.images, index);
        const View view(plan, place.image);
        for (int axis = 0; axis < 2; ++axis) {
            if (axis == 0 ? place.column + 1 >= view.width : place.row + 1 >= view.height) continue;
            const Pair pair{place.row, place.column, axis};
            const Code code = find_edge(view, pair, gradient);
            if (code == 0) continue;
            for_motion(view, pair, code, gradient, [&](std::size_t vertex, float x, float y, float z, float w) {
                float* to = positions + 4 * vertex;
                device::atomic_add(to, x);
                device::atomic_add(to + 1, y);
                if (z != 0) device::atomic_add(to + 2, z);
                device::atomic_add(to + 3, w);
            });
        }
    }
};

}  // namespace

std::size_t workspace_bytes(const Mesh& mesh, std::size_t images) {
    device::Arena arena(nullptr);
    arena.take<std::uint8_t>(instances_of(mesh, images) * mesh.triangle_count);
    return arena.bytes();
}

void edge_gradients(const Mesh& mesh, const antialias::Images& images, void* workspace, const float* gradient,
                    float* positions, void* stream) {
    const device::Executor executor(stream);
    const std::size_t instances = instances_of(mesh, images.count), flags = instances * mesh.triangle_count;
    std::uint8_t* const silhouettes = device::Arena(workspace).take<std::uint8_t>(flags);
    executor.for_each(flags, FindSilhouettes{mesh, silhouettes});
    executor.for_each(4 * instances * mesh.vertices, device::Clear{positions});
    executor.for_each(images.count * images.pixels(), MoveEdges{{mesh, images, silhouettes}, gradient, positions});
}

}  // namespace fourd::edge_gradients::cuda
