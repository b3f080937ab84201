// Finds the triangles that rays hit. All triangles of a block are tested at once.
#include "rays/cpu/loops.h"

#if defined(FOURD_X86)
#include <immintrin.h>
#endif

#include <cstring>

#include "common/inline.h"
#include "rays/hit_list.h"
#include "rays/maths.h"

namespace fourd::rays::FOURD_SIMD {
namespace {

#include "rays/cpu/lanes.inc"
#include "rays/cpu/traversal.inc"

// Returns a mask of the lanes whose triangles may pass the test in intersect(). A triangle cannot pass the test if it
// has both a positive and a negative corner weight.
FOURD_INLINE unsigned triangles_near(const WideRay& ray, const Block& block) {
    const int axes[3] = {ray.ray.x, ray.ray.y, ray.ray.z};
    Lanes x[3], y[3];
    for (int k = 0; k < 3; ++k) {
        const Lanes z = load(block.corner[k][axes[2]]) - ray.origin[2];
        x[k] = (load(block.corner[k][axes[0]]) - ray.origin[0]) - ray.shear_x * z;
        y[k] = (load(block.corner[k][axes[1]]) - ray.origin[1]) - ray.shear_y * z;
    }
    const Lanes a = x[2] * y[1] - y[2] * x[1], b = x[0] * y[2] - y[0] * x[2], c = x[1] * y[0] - y[1] * x[0];
    return ~(is_mixed(a, b, c) | is_negative(block.triangle)) & 0xffu;
}

FOURD_INLINE bool intersect_lane(const Ray& ray, const Block& block, int lane, Hit* hit) {
    float corners[3][3];
    for (int k = 0; k < 3; ++k) {
        for (int axis = 0; axis < 3; ++axis) corners[k][axis] = block.corner[k][axis][lane];
    }
    hit->triangle = block.triangle[lane];
    return intersect(ray, corners[0], corners[1], corners[2], hit);
}

void trace(const TreeView& tree, const Rays& rays, std::size_t begin, std::size_t end, const Hits& hits) {
    for (std::size_t index = begin; index < end; ++index) {
        HitList nearest(rays, hits, index);
        WideRay ray;
        if (!prepare_ray(tree.node_count, tree.magnitude, rays, index, &ray)) continue;
        traverse(tree.nodes, tree.blocks, ray, first_of(ray.ray), last_of(ray.ray, ray.ray.t_max),
                 [&](const Block& block, float* last) FOURD_INLINE_LAMBDA {
                     for (unsigned bits = triangles_near(ray, block); bits != 0; bits &= bits - 1) {
                         Hit hit;
                         if (intersect_lane(ray.ray, block, lowest_bit(bits), &hit)) nearest.add(hit);
                     }
                     if (nearest.is_full()) {
                         const float bound = last_of(ray.ray, nearest.t[nearest.found - 1]);
                         if (bound < *last) *last = bound;
                     }
                     return false;
                 });
    }
}

void occluded(const TreeView& tree, const Rays& rays, std::size_t begin, std::size_t end, std::uint8_t* out) {
    for (std::size_t index = begin; index < end; ++index) {
        out[index] = 0;
        WideRay ray;
        if (!prepare_ray(tree.node_count, tree.magnitude, rays, index, &ray)) continue;
        traverse(tree.nodes, tree.blocks, ray, first_of(ray.ray), last_of(ray.ray, ray.ray.t_max),
                 [&](const Block& block, float*) FOURD_INLINE_LAMBDA {
                     for (unsigned bits = triangles_near(ray, block); bits != 0; bits &= bits - 1) {
                         Hit hit;
                         if (intersect_lane(ray.ray, block, lowest_bit(bits), &hit)) {
                             out[index] = 1;
                             return true;
                         }
                     }
                     return false;
                 });
    }
}

}  // namespace

const Loops loops = {trace, occluded};

}  // namespace fourd::rays::FOURD_SIMD
