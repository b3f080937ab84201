#include "rays/cuda/trace.h"

#include "device/clear.h"
#include "device/executor.h"
#include "rays/cuda/traversal.h"
#include "rays/hit_list.h"
#include "rays/maths.h"

namespace fourd::rays::cuda {
namespace {

// Calls visit(hit) for each hit in a block. If visit(hit) returns true, the traversal ends.
template <typename Visit>
FOURD_DEVICE static bool visit_block(const Ray& ray, const Block& block, const Visit& visit) {
    for (int lane = 0; lane < kWidth; ++lane) {
        Hit hit;
        hit.triangle = block.triangle[lane];
        if (hit.triangle < 0) continue;
        float corners[3][3];
        for (int k = 0; k < 3; ++k) {
            for (int axis = 0; axis < 3; ++axis) corners[k][axis] = block.corner[k][axis][lane];
        }
        if (intersect(ray, corners[0], corners[1], corners[2], &hit) && visit(hit)) return true;
    }
    return false;
}

struct Trace {
    TreeView tree;
    Rays rays;
    Hits hits;

    FOURD_DEVICE void operator()(std::size_t index) const {
        HitList nearest(rays, hits, index);
        Ray ray;
        if (!prepare_ray(tree.node_count, tree.magnitude, rays, index, &ray)) return;
        const auto add = [&nearest](const Hit& hit) {
            nearest.add(hit);
            return false;
        };
        const auto visit = [&ray, &add](const Block& block) { return visit_block(ray, block, add); };
        const auto last = [&nearest, &ray] {
            return last_of(ray, nearest.is_full() ? nearest.t[nearest.found - 1] : ray.t_max);
        };
        traverse(tree.nodes, tree.blocks, ray, visit, last);
    }
};

struct Occluded {
    TreeView tree;
    Rays rays;
    std::uint8_t* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        Ray ray;
        out[index] = 0;
        if (!prepare_ray(tree.node_count, tree.magnitude, rays, index, &ray)) return;
        std::uint8_t* const flag = out + index;
        const auto mark = [flag](const Hit&) {
            *flag = 1;
            return true;
        };
        const auto visit = [&ray, &mark](const Block& block) { return visit_block(ray, block, mark); };
        const float bound = last_of(ray, ray.t_max);
        const auto last = [bound] { return bound; };
        traverse(tree.nodes, tree.blocks, ray, visit, last);
    }
};

struct Backward {
    Mesh mesh;
    HitGradients gradients;

    FOURD_DEVICE void operator()(std::size_t ray) const {
        const std::size_t layers = static_cast<std::size_t>(gradients.layers);
        float to_origin[3] = {0.0f, 0.0f, 0.0f}, to_direction[3] = {0.0f, 0.0f, 0.0f};
        for (std::size_t hit = ray * layers; hit < (ray + 1) * layers; ++hit) {
            std::size_t at[3];
            if (!mesh.find(gradients.triangle[hit], at)) continue;
            float y[3];
            hit_gradient(gradients.directions + 3 * ray, mesh.xyz + 3 * at[0], mesh.xyz + 3 * at[1],
                         mesh.xyz + 3 * at[2], gradients.to_t[hit], gradients.to_u[hit], gradients.to_v[hit], y);
            const float u = gradients.u[hit], v = gradients.v[hit], weights[3] = {u, v, (1.0f - u) - v};
            for (int i = 0; i < 3; ++i) {
                to_origin[i] += y[i];
                to_direction[i] += gradients.t[hit] * y[i];
                for (int k = 0; k < 3; ++k) device::atomic_add(gradients.xyz + 3 * at[k] + i, -weights[k] * y[i]);
            }
        }
        for (int i = 0; i < 3; ++i) {
            gradients.to_origins[3 * ray + i] = to_origin[i];
            gradients.to_directions[3 * ray + i] = to_direction[i];
        }
    }
};

}  // namespace

void trace(const TreeView& tree, const Rays& rays, const Hits& hits, void* stream) {
    device::Executor(stream).for_each(rays.count, Trace{tree, rays, hits});
}

void occluded(const TreeView& tree, const Rays& rays, std::uint8_t* out, void* stream) {
    device::Executor(stream).for_each(rays.count, Occluded{tree, rays, out});
}

void trace_backward(const Mesh& mesh, const HitGradients& gradients, void* stream) {
    const device::Executor executor(stream);
    executor.for_each(3 * mesh.vertices, device::Clear{gradients.xyz});
    executor.for_each(gradients.count, Backward{mesh, gradients});
}

}  // namespace fourd::rays::cuda
