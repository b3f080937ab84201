// Depth-first traversal of a tree for one ray on a GPU. The leaves of the tree, called blocks, contain triangles or
// discs.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "rays/maths.h"
#include "rays/rays.h"

namespace fourd::rays::cuda {

FOURD_DEVICE inline bool meets_box(const Ray& ray, const Node& node, int lane, float first, float last, float* entry) {
    float enter = first, leave = last;
    for (int axis = 0; axis < 3; ++axis) {
        const float low = node.bounds[2 * axis][lane], high = node.bounds[2 * axis + 1][lane];
        const float near = ray.inverse[axis] < 0.0f ? high : low, far = ray.inverse[axis] < 0.0f ? low : high;
        const float from = near * ray.inverse[axis] - ray.enter[axis], to = far * ray.inverse[axis] - ray.leave[axis];
        if (from > enter) enter = from;
        if (to < leave) leave = to;
    }
    *entry = enter;
    return enter <= leave;
}

struct Entry {
    float t;  // The scaled parameter t' (rays/maths.h) at which the ray enters the box.
    std::int32_t child;
};

// Calls visit(block) for the blocks whose boxes the ray meets at a t' from first_of(ray) to last(). The function last()
// of the caller returns the current upper limit of t', which may become smaller during the traversal. visit(block)
// returns true to end the traversal.
template <typename Block, typename Visit, typename Last>
FOURD_DEVICE void traverse(const Node* nodes, const Block* blocks, const Ray& ray, Visit& visit, const Last& last) {
    const float first = first_of(ray);
    Entry stack[kMaxStack];
    int size = 0;
    stack[size++] = {first, 0};
    while (size > 0) {
        const Entry top = stack[--size];
        if (top.t > last()) continue;
        if (top.child < 0) {
            if (visit(blocks[~top.child])) return;
            continue;
        }
        const Node& node = nodes[top.child];
        const int bottom = size;
        for (int lane = 0; lane < kWidth; ++lane) {
            float entry;
            if (node.child[lane] == kNoChild || !meets_box(ray, node, lane, first, last(), &entry)) continue;
            int at = size++;
            for (; at > bottom && stack[at - 1].t < entry; --at) stack[at] = stack[at - 1];
            stack[at] = {entry, node.child[lane]};
        }
    }
}

FOURD_DEVICE inline bool prepare_ray(std::size_t node_count, float magnitude, const Rays& rays, std::size_t index,
                                     Ray* out) {
    return node_count > 0 &&
           prepare(rays.origins + 3 * index, rays.directions + 3 * index, rays.t_min[index * rays.t_min_stride],
                   rays.t_max[index * rays.t_max_stride], magnitude, out);
}

}  // namespace fourd::rays::cuda
