// Depth-first traversal of the tree for one ray at a time: the boxes of all children of a node, and all triangles of a
// block, are tested at once.
#include "rays/cpu/loops.h"

#if defined(FOURD_X86)
#include <immintrin.h>
#endif

#include <cstring>

#include "common/inline.h"
#include "rays/maths.h"

namespace fourd::rays::FOURD_SIMD {
namespace {

#include "rays/cpu/lanes.inc"

struct Entry {
    float t;  // The ray enters the box at t'.
    std::int32_t child;
};

// A ray with what the lanes need. Member `near` selects the bounds of a node that the ray meets first.
struct WideRay {
    Ray ray;
    Lanes inverse[3], enter[3], leave[3];
    Lanes origin[3], shear_x, shear_y;  // Permuted like Ray::x, y and z.
    int near[3];
};

FOURD_INLINE void widen(const Ray& ray, WideRay* out) {
    const int axes[3] = {ray.x, ray.y, ray.z};
    out->ray = ray;
    for (int i = 0; i < 3; ++i) {
        out->inverse[i] = broadcast(ray.inverse[i]);
        out->enter[i] = broadcast(ray.enter[i]);
        out->leave[i] = broadcast(ray.leave[i]);
        out->origin[i] = broadcast(ray.origin[axes[i]]);
        out->near[i] = ray.inverse[i] < 0.0f ? 1 : 0;
    }
    out->shear_x = broadcast(ray.shear_x);
    out->shear_y = broadcast(ray.shear_y);
}

// Bits of the children whose boxes the ray meets between t' = first and t' = last, and the t' of their entry.
FOURD_INLINE unsigned boxes_hit(const WideRay& ray, const Node& node, float first, float last, float* entry) {
    Lanes enter = broadcast(first), leave = broadcast(last);
    for (int i = 0; i < 3; ++i) {
        const int near = 2 * i + ray.near[i], far = 2 * i + 1 - ray.near[i];
        enter = larger(load(node.bounds[near]) * ray.inverse[i] - ray.enter[i], enter);
        leave = smaller(load(node.bounds[far]) * ray.inverse[i] - ray.leave[i], leave);
    }
    store(entry, enter);
    return is_less_or_equal(enter, leave);
}

// Bits of the triangles that intersect() may accept: those with a corner, and with weights of one sign. Weights equal
// to 0 count as both signs.
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

// Visits the blocks that the ray meets. visit(block, &last) may reduce `last`, the largest t' that is of interest, and
// returns whether the traversal is finished.
template <typename Visit>
FOURD_INLINE void traverse(const TreeView& tree, const WideRay& ray, float first, float last, const Visit& visit) {
    Entry stack[kMaxStack];
    int size = 0;
    std::int32_t child = 0;
    for (;;) {
        while (child >= 0) {
            const Node& node = tree.nodes[child];
            alignas(32) float entry[kWidth];
            unsigned bits = boxes_hit(ray, node, first, last, entry);
            if (bits == 0) break;
            const int lane = lowest_bit(bits);
            bits &= bits - 1;
            Entry nearest{entry[lane], node.child[lane]};
            if (bits == 0) {
                child = nearest.child;
                continue;
            }
            const int bottom = size;
            for (; bits != 0; bits &= bits - 1) {
                const int other = lowest_bit(bits);
                Entry next{entry[other], node.child[other]};
                if (next.t < nearest.t) {
                    const Entry swapped = nearest;
                    nearest = next;
                    next = swapped;
                }
                int at = size++;
                for (; at > bottom && stack[at - 1].t < next.t; --at) stack[at] = stack[at - 1];
                stack[at] = next;
            }
            child = nearest.child;
        }
        if (child < 0 && child != kNoChild && visit(tree.blocks[~child], &last)) return;
        do {
            if (size == 0) return;
            --size;
        } while (stack[size].t > last);
        child = stack[size].child;
    }
}

// The end of the interval of t' that contains all t up to `t`. The added number covers the rounding of tiny t.
FOURD_INLINE float last_of(const Ray& ray, float t) { return t * ray.inverse_scale + 1.17549435e-38f * ray.inverse_scale; }

// The smallest t' of interest, rounded down as in last_of.
FOURD_INLINE float first_of(const Ray& ray) { return ray.t_min * ray.inverse_scale - 1.17549435e-38f * ray.inverse_scale; }

FOURD_INLINE bool prepare_ray(const TreeView& tree, const Rays& rays, std::size_t index, WideRay* out) {
    Ray ray;
    if (tree.node_count == 0 || !prepare(rays.origins + 3 * index, rays.directions + 3 * index,
                                         rays.t_min[index * rays.t_min_stride], rays.t_max[index * rays.t_max_stride],
                                         tree.magnitude, &ray)) {
        return false;
    }
    widen(ray, out);
    return true;
}

struct NearestHits {
    const Rays& rays;
    const Ray& ray;
    std::size_t index;
    int layers, found;
    float *t, *u, *v;
    std::int32_t* triangle;

    FOURD_INLINE void add(const Hit& hit) {
        if (rays.after_t != nullptr && !is_after(hit.t, hit.triangle, rays.after_t[index], rays.after_triangle[index])) return;
        if (found == layers && !is_after(t[found - 1], triangle[found - 1], hit.t, hit.triangle)) return;
        int at = found < layers ? found++ : found - 1;
        for (; at > 0 && is_after(t[at - 1], triangle[at - 1], hit.t, hit.triangle); --at) {
            t[at] = t[at - 1];
            u[at] = u[at - 1];
            v[at] = v[at - 1];
            triangle[at] = triangle[at - 1];
        }
        t[at] = hit.t;
        u[at] = hit.u;
        v[at] = hit.v;
        triangle[at] = hit.triangle;
    }
};

void trace(const TreeView& tree, const Rays& rays, std::size_t begin, std::size_t end, const Hits& hits) {
    for (std::size_t index = begin; index < end; ++index) {
        const std::size_t to = index * static_cast<std::size_t>(hits.layers);
        for (int k = 0; k < hits.layers; ++k) {
            hits.t[to + k] = __builtin_huge_valf();
            hits.u[to + k] = hits.v[to + k] = 0.0f;
            hits.triangle[to + k] = -1;
        }
        WideRay ray;
        if (!prepare_ray(tree, rays, index, &ray)) continue;
        NearestHits nearest{rays, ray.ray, index, hits.layers, 0, hits.t + to, hits.u + to, hits.v + to, hits.triangle + to};
        traverse(tree, ray, first_of(ray.ray), last_of(ray.ray, ray.ray.t_max),
                 [&](const Block& block, float* last) FOURD_INLINE_LAMBDA {
                     for (unsigned bits = triangles_near(ray, block); bits != 0; bits &= bits - 1) {
                         Hit hit;
                         if (intersect_lane(ray.ray, block, lowest_bit(bits), &hit)) nearest.add(hit);
                     }
                     if (nearest.found == nearest.layers) {
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
        if (!prepare_ray(tree, rays, index, &ray)) continue;
        traverse(tree, ray, first_of(ray.ray), last_of(ray.ray, ray.ray.t_max),
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
