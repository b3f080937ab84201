// Clips triangles against a frustum that is much wider than the image (Sutherland and Hodgman 1974). The new vertex on
// a clipped edge depends only on the two vertices of the edge, so two triangles that share an edge get the same new
// vertices.
#pragma once

#include "rasterize/maths.h"

namespace fourd::rasterize {

constexpr int kClipPlanes = 4;
constexpr int kMaxCorners = 3 + kClipPlanes;    // Every plane adds at most one corner to a convex polygon.
constexpr int kMaxPieces = kMaxCorners - 2;

struct Corner {
    double x, y, w;
};

// Returns the distance of a corner from a clipping plane. The distance is positive inside the frustum and 0 on its
// boundary. The distances from two opposite planes add up to 2 * guard * w, so w is at least 0 where both distances are
// at least 0.
FOURD_HD static inline double clip_distance(const Screen& screen, int plane, const Corner& corner) {
    const double guard = plane < 2 ? screen.guard_x : screen.guard_y;
    const double coordinate = plane < 2 ? corner.x : corner.y;
    return guard * corner.w + (plane % 2 == 0 ? coordinate : -coordinate);
}

// Returns the intersection of a plane with an edge whose ends lie on different sides of the plane.
FOURD_HD static inline Corner intersection(const Corner& inside, double d_inside, const Corner& outside,
                                           double d_outside) {
    const double t = d_inside / (d_inside - d_outside);
    return {inside.x + t * (outside.x - inside.x), inside.y + t * (outside.y - inside.y),
            inside.w + t * (outside.w - inside.w)};
}

FOURD_HD static inline Snapped snap_corner(const Screen& screen, const Corner& corner) {
    float x = static_cast<float>(corner.x), y = static_cast<float>(corner.y);
    const float w = static_cast<float>(corner.w);
    if (!(w > 0.0f)) return snap_inside(screen, 0.0f, 0.0f, 1.0f);
    const float limit_x = screen.guard_x * w, limit_y = screen.guard_y * w;
    x = x < -limit_x ? -limit_x : (x > limit_x ? limit_x : x);
    y = y < -limit_y ? -limit_y : (y > limit_y ? limit_y : y);
    return snap_inside(screen, x, y, w);
}

// Writes the corners of the clipped triangle to `out` (kMaxCorners,), and returns their count.
FOURD_HD static inline int clip(const Screen& screen, const float* p0, const float* p1, const float* p2, Snapped* out) {
    Corner from[kMaxCorners] = {{p0[0], p0[1], p0[3]}, {p1[0], p1[1], p1[3]}, {p2[0], p2[1], p2[3]}};
    int count = 3;
    for (int plane = 0; plane < kClipPlanes && count > 0; ++plane) {
        Corner to[kMaxCorners + 1];
        int kept = 0;
        for (int i = 0; i < count; ++i) {
            const Corner& here = from[i];
            const Corner& next = from[i + 1 == count ? 0 : i + 1];
            const double d = clip_distance(screen, plane, here), d_next = clip_distance(screen, plane, next);
            if (d >= 0.0) to[kept++] = here;
            if (d >= 0.0 && d_next < 0.0) to[kept++] = intersection(here, d, next, d_next);
            if (d < 0.0 && d_next >= 0.0) to[kept++] = intersection(next, d_next, here, d);
            if (kept >= kMaxCorners) break;
        }
        // If coordinates differ by a factor of more than 2^53, rounding can make the polygon concave. A plane can then
        // add two corners. The last corner is dropped if there is no space for it.
        count = kept < kMaxCorners ? kept : kMaxCorners;
        for (int i = 0; i < count; ++i) from[i] = to[i];
    }
    for (int i = 0; i < count; ++i) out[i] = snap_corner(screen, from[i]);
    return count;
}

FOURD_HD static inline bool all_inside(const Snapped& a, const Snapped& b, const Snapped& c) {
    return a.state == VertexState::inside && b.state == VertexState::inside && c.state == VertexState::inside;
}

// Sets the reference pixel of a piece. The struct Planes (maths.h) stores linear functions over the image, such as z/w,
// as their values at the reference pixel and their slopes. The reference pixel is the centre of the image for a clipped
// triangle, and the first pixel of the bounding box for any other triangle.
FOURD_HD static inline void set_reference(const Screen& screen, bool is_clipped, const Bounds& bounds, Piece* piece) {
    piece->reference_x = static_cast<std::uint16_t>(is_clipped ? screen.width / 2 : bounds.left);
    piece->reference_y = static_cast<std::uint16_t>(is_clipped ? screen.height / 2 : bounds.top);
}

// Calls take(piece, bounds) for each piece (part of a clipped triangle, or whole triangle) that may cover pixels. The
// arguments a, b and c are the vertices, rounded to 1/256 pixel (Snapped in maths.h), and p0, p1 and p2 are their clip
// coordinates. Triangles with an invalid vertex have no pieces.
template <typename Take>
FOURD_HD static inline void for_pieces(const Screen& screen, const Snapped& a, const Snapped& b, const Snapped& c,
                                       const float* p0, const float* p1, const float* p2, int triangle,
                                       const Take& take) {
    Piece piece;
    if (all_inside(a, b, c)) {
        if (!make_piece(a, b, c, triangle, &piece)) return;
        const Bounds bounds = bounds_of(screen, piece);
        if (bounds.is_empty()) return;
        set_reference(screen, false, bounds, &piece);
        take(piece, bounds);
        return;
    }
    if (a.state == VertexState::invalid || b.state == VertexState::invalid || c.state == VertexState::invalid) return;
    Snapped corners[kMaxCorners];
    const int count = clip(screen, p0, p1, p2, corners);
    for (int i = 1; i + 1 < count; ++i) {
        if (!make_piece(corners[0], corners[i], corners[i + 1], triangle, &piece)) continue;
        const Bounds bounds = bounds_of(screen, piece);
        if (bounds.is_empty()) continue;
        set_reference(screen, true, bounds, &piece);
        take(piece, bounds);
    }
}

}  // namespace fourd::rasterize
