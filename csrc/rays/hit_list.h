// Keeps the nearest hits of a ray in order. Every backend uses this code.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/inline.h"
#include "rays/maths.h"
#include "rays/rays.h"

namespace fourd::rays {

// Up to `layers` hits of one ray: the nearest hits found so far, in ascending order of (t, triangle). The list is
// stored in the arrays of Hits.
struct HitList {
    int layers, found;
    float *t, *u, *v;
    std::int32_t* triangle;
    bool is_continued;  // If true, only hits after (after_t, after_triangle) are added.
    float after_t;
    std::int32_t after_triangle;

    // Starts an empty list for the ray with this index.
    FOURD_HD FOURD_INLINE HitList(const Rays& rays, const Hits& hits, std::size_t index)
        : layers(hits.layers), found(0), is_continued(rays.after_t != nullptr), after_t(0.0f), after_triangle(0) {
        const std::size_t first = index * static_cast<std::size_t>(layers);
        t = hits.t + first;
        u = hits.u + first;
        v = hits.v + first;
        triangle = hits.triangle + first;
        if (is_continued) after_t = rays.after_t[index], after_triangle = rays.after_triangle[index];
        for (int k = 0; k < layers; ++k) {
            t[k] = kInfinity;
            u[k] = v[k] = 0.0f;
            triangle[k] = -1;
        }
    }

    FOURD_HD FOURD_INLINE bool is_full() const { return found == layers; }

    FOURD_HD FOURD_INLINE void add(const Hit& hit) {
        if (is_continued && !is_after(hit.t, hit.triangle, after_t, after_triangle)) return;
        if (is_full() && !is_after(t[found - 1], triangle[found - 1], hit.t, hit.triangle)) return;
        int at = is_full() ? found - 1 : found++;
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

}  // namespace fourd::rays
