#include <algorithm>

#include "common/team.h"
#include "rays/cpu/loops.h"
#include "rays/maths.h"
#include "rays/rays.h"

namespace fourd::rays {
namespace {

constexpr std::size_t kRaysPerTask = 2048;
constexpr std::size_t kHitsPerTask = 16384;

}  // namespace

void trace(const TreeView& tree, const Rays& rays, const Hits& hits) {
    const Loops& loops = select_loops(rays.simd);
    Team team(rays.threads);
    run_parts(team, rays.count, kRaysPerTask,
              [&](std::size_t begin, std::size_t end) { loops.trace(tree, rays, begin, end, hits); });
}

void occluded(const TreeView& tree, const Rays& rays, std::uint8_t* out) {
    const Loops& loops = select_loops(rays.simd);
    Team team(rays.threads);
    run_parts(team, rays.count, kRaysPerTask,
              [&](std::size_t begin, std::size_t end) { loops.occluded(tree, rays, begin, end, out); });
}

void trace_backward(const Mesh& mesh, const HitGradients& gradients) {
    const std::size_t layers = static_cast<std::size_t>(gradients.layers), hits = gradients.count * layers;
    Buffer<float> per_hit(3 * hits);
    Team team(gradients.threads);
    run_parts(team, gradients.count, std::max<std::size_t>(1, kHitsPerTask / layers), [&](std::size_t begin, std::size_t end) {
        for (std::size_t ray = begin; ray < end; ++ray) {
            float to_origin[3] = {0.0f, 0.0f, 0.0f}, to_direction[3] = {0.0f, 0.0f, 0.0f};
            for (std::size_t hit = ray * layers; hit < (ray + 1) * layers; ++hit) {
                float* const y = per_hit.data() + 3 * hit;
                y[0] = y[1] = y[2] = 0.0f;
                std::size_t at[3];
                if (!mesh.find(gradients.triangle[hit], at)) continue;
                const auto corner = [&](int k) { return mesh.xyz + 3 * at[k]; };
                hit_gradient(gradients.directions + 3 * ray, corner(0), corner(1), corner(2), gradients.to_t[hit],
                             gradients.to_u[hit], gradients.to_v[hit], y);
                for (int i = 0; i < 3; ++i) {
                    to_origin[i] += y[i];
                    to_direction[i] += gradients.t[hit] * y[i];
                }
            }
            std::copy_n(to_origin, 3, gradients.to_origins + 3 * ray);
            std::copy_n(to_direction, 3, gradients.to_directions + 3 * ray);
        }
    });
    std::fill_n(gradients.xyz, 3 * mesh.vertices, 0.0f);
    for (std::size_t hit = 0; hit < hits; ++hit) {
        std::size_t at[3];
        if (!mesh.find(gradients.triangle[hit], at)) continue;
        const float u = gradients.u[hit], v = gradients.v[hit], weights[3] = {u, v, (1.0f - u) - v};
        for (std::size_t k = 0; k < 3; ++k) {
            float* const to = gradients.xyz + 3 * at[k];
            for (std::size_t i = 0; i < 3; ++i) to[i] -= weights[k] * per_hit[3 * hit + i];
        }
    }
}

}  // namespace fourd::rays
