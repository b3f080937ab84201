// Finds silhouette edges, and the points where these edges cross the segment between two neighbouring pixel centres.
//
// Let f = (f_x, f_y) be the centre of a pixel in normalised device coordinates. Relative to f, a vertex (x, y, z, w) in
// clip space has the coordinates (a, b, w):
//     a = x - f_x * w, b = y - f_y * w
// The point f lies on the line through the vertices j and k if N is 0:
//     N = a_j b_k - b_j a_k
// N is a linear function of f, even if a vertex has w <= 0. Let s be the distance between neighbouring pixel centres
// along x. If f moves by t * s along x, N decreases by t * D:
//     D = s * (w_j b_k - b_j w_k)
// The segment from f to the centre of the right neighbour therefore crosses the line at t = N / D. Along y, the same
// formulas hold with a and b exchanged.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/inline.h"
#include "common/triangle_id.h"

namespace fourd::antialias {

// Because the rasterizer rounds vertices to a subpixel grid, an edge in the image can be up to kTolerancePx pixels away
// from the edge between the exact vertices.
constexpr float kTolerancePx = 0.0625f;
// Largest absolute value of the derivatives in Crossing::slope, in pixels per unit of clip space. Edges with a larger
// derivative have no gradient.
constexpr float kMaxSlope = 1.0e18f;

struct Mesh {
    const float* positions;  // Shape (instances, vertices, 4), in clip space.
    const int* triangles;    // Shape (triangle_count, 3): vertex indices.
    // Shape (triangle_count, 3). Edge i of a triangle lies opposite to its vertex i. Element i is the index of the
    // third vertex of the triangle on the other side of edge i, or -1 if edge i is always a silhouette.
    const int* opposite;
    std::size_t vertices, triangle_count;
    bool instanced;  // Whether every image has its own positions. If false, all images share the same positions.

    FOURD_HD FOURD_INLINE std::size_t first_vertex(std::size_t image) const { return instanced ? image * vertices : 0; }
    FOURD_HD FOURD_INLINE bool has(int vertex) const { return static_cast<std::size_t>(vertex) < vertices && vertex >= 0; }
};

struct Vertex {
    float x, y, w;
};

FOURD_HD static inline Vertex vertex_at(const Mesh& mesh, std::size_t first_vertex, int index) {
    const float* at = mesh.positions + 4 * (first_vertex + index);
    return {at[0], at[1], at[3]};
}

// Returns the determinant of p, q and r. The camera and the vertices p and q span a plane, and the sign of the
// determinant states on which side of this plane r lies. The determinant is computed from differences, so that it is
// exactly 0 if two vertices are equal.
FOURD_HD static inline float side_of(const Vertex& p, const Vertex& q, const Vertex& r) {
    const Vertex e{q.x - p.x, q.y - p.y, q.w - p.w}, d{r.x - p.x, r.y - p.y, r.w - p.w};
    return (p.x * (e.y * d.w - e.w * d.y) + p.y * (e.w * d.x - e.x * d.w)) + p.w * (e.x * d.y - e.y * d.x);
}

// Returns a mask in which bit i is 1 if the edge opposite to vertex i of the triangle is a silhouette. An edge is a
// silhouette unless its Mesh::opposite vertex and vertex i lie on opposite sides of it in the image.
FOURD_HD static inline std::uint8_t silhouettes_of(const Mesh& mesh, std::size_t first_vertex, std::size_t triangle) {
    const int* of = mesh.triangles + 3 * triangle;
    if (!mesh.has(of[0]) || !mesh.has(of[1]) || !mesh.has(of[2])) return 0;
    const int* opposite = mesh.opposite + 3 * triangle;
    const Vertex corners[3] = {vertex_at(mesh, first_vertex, of[0]), vertex_at(mesh, first_vertex, of[1]),
                               vertex_at(mesh, first_vertex, of[2])};
    unsigned bits = 0;
    for (int i = 0; i < 3; ++i) {
        bool silhouette = true;
        if (mesh.has(opposite[i])) {
            const Vertex &p = corners[(i + 1) % 3], &q = corners[(i + 2) % 3];
            const float own = side_of(p, q, corners[i]);
            const float other = side_of(p, q, vertex_at(mesh, first_vertex, opposite[i]));
            silhouette = !((own > 0 && other < 0) || (own < 0 && other > 0));
        }
        bits |= static_cast<unsigned>(silhouette) << i;
    }
    return static_cast<std::uint8_t>(bits);
}

// The pair of a pixel with its right neighbour (axis 0) or its lower neighbour (axis 1).
struct Pair {
    int row, column, axis;
};

// Describes, as bits of a byte, the silhouette edges that cross the two pairs of a pixel. Bits 0 to 2 describe the pair
// with the right neighbour. Bits 0 and 1 hold 0 if no edge crosses the pair, and otherwise the index (0 to 2) of the
// edge in its triangle, plus 1. Bit 2 is set if the edge belongs to the triangle of the right neighbour. Bits 3 to 5
// describe the pair with the lower neighbour in the same way.
using Code = unsigned;
constexpr int kBitsPerPair = 3;

FOURD_HD static inline int edge_of(Code code, int axis) { return static_cast<int>(code >> (kBitsPerPair * axis) & 3u); }
FOURD_HD static inline bool owner_is_neighbour(Code code, int axis) {
    return (code >> (kBitsPerPair * axis) & 4u) != 0;
}
FOURD_HD static inline Code code_of(int edge_number, bool neighbour, int axis) {
    return (static_cast<Code>(edge_number) | (neighbour ? 4u : 0u)) << (kBitsPerPair * axis);
}

// The origin and the axes of the coordinates that describe a pair of pixels. The origin is the owner of the pair, which
// is the pixel whose triangle is nearer. The axis `along` points to the other pixel of the pair, and the axis `across`
// is perpendicular to it.
struct Sight {
    float along, across;            // The centre of the owner in normalised device coordinates.
    // Distances between neighbouring pixel centres in normalised device coordinates. step_along is negative if the
    // owner is the second pixel of the pair.
    float step_along, step_across;
    int axis;

    FOURD_HD FOURD_INLINE Sight(const Pair& pair, bool neighbour, int height, int width) : axis(pair.axis) {
        const int row = pair.row + (neighbour && axis == 1), column = pair.column + (neighbour && axis == 0);
        const float x = static_cast<float>(2 * column + 1) / static_cast<float>(width) - 1.0f;
        const float y = static_cast<float>(2 * row + 1) / static_cast<float>(height) - 1.0f;
        const float step_x = 2.0f / static_cast<float>(width), step_y = 2.0f / static_cast<float>(height);
        along = axis == 0 ? x : y;
        across = axis == 0 ? y : x;
        step_along = axis == 0 ? step_x : step_y;
        step_across = axis == 0 ? step_y : step_x;
        if (neighbour) step_along = -step_along;
    }
};

struct Seen {
    float a, b, w;
};

FOURD_HD static inline Seen see(const Sight& sight, const Vertex& v) {
    const float a = sight.axis == 0 ? v.x : v.y, b = sight.axis == 0 ? v.y : v.x;
    return {a - sight.along * v.w, b - sight.across * v.w, v.w};
}

// The line through p and q, as the linear function N that is 0 on the line (see the top of this file). `value` is N at
// the centre of the owner. fall_along and fall_across are the decreases of N per pixel in the directions `along` and
// `across`.
struct Line {
    float value, fall_along, fall_across;

    FOURD_HD FOURD_INLINE Line(const Sight& sight, const Seen& p, const Seen& q)
        : value(p.a * q.b - p.b * q.a),
          fall_along(sight.step_along * (p.w * q.b - p.b * q.w)),
          fall_across(sight.step_across * (p.a * q.w - p.w * q.a)) {}
};

FOURD_HD static inline float magnitude(float value) { return value < 0 ? -value : value; }

// Finds the edge through which the segment from the owner's centre to the other pixel's centre leaves the owner's
// triangle. Returns 1 plus the index (0 to 2) of this edge if it is a silhouette, and 0 otherwise. Edges at less than
// 45 degrees to the segment, in pixel coordinates, are ignored, so that every piece of a silhouette is blended along
// only one axis. `silhouettes` is the result of silhouettes_of().
FOURD_HD static inline int crossed_edge(const Mesh& mesh, std::size_t first_vertex, const Sight& sight, int triangle,
                                        unsigned silhouettes) {
    const int* of = mesh.triangles + 3 * static_cast<std::size_t>(triangle);
    const Seen p = see(sight, vertex_at(mesh, first_vertex, of[0]));
    const Seen q = see(sight, vertex_at(mesh, first_vertex, of[1]));
    const Seen r = see(sight, vertex_at(mesh, first_vertex, of[2]));
    Line lines[3] = {Line(sight, q, r), Line(sight, r, p), Line(sight, p, q)};
    const float inside = lines[0].value + lines[1].value + lines[2].value;
    const float sign = inside < 0 ? -1.0f : 1.0f;
    int edge = 0;
    float nearest = 1 + kTolerancePx;
    for (int i = 0; i < 3; ++i) {
        lines[i].value *= sign;
        lines[i].fall_along *= sign;
        const float across = magnitude(lines[i].fall_across);
        const bool perpendicular =
            sight.axis == 0 ? lines[i].fall_along >= across : lines[i].fall_along > across;
        if (!perpendicular || !(lines[i].fall_along > 0)) continue;
        const float crossing = lines[i].value / lines[i].fall_along;
        if (!(crossing >= -kTolerancePx && crossing <= nearest)) continue;
        nearest = crossing;
        edge = i + 1;
    }
    if (edge == 0 || (silhouettes >> (edge - 1) & 1u) == 0) return 0;
    // The infinite line through the edge crosses the segment, but the crossing point must also lie between the two ends
    // of the edge.
    for (int i = 0; i < 3; ++i) {
        if (i + 1 == edge) continue;
        const float slack = kTolerancePx * (magnitude(lines[i].fall_along) + magnitude(lines[i].fall_across));
        if (!(lines[i].value - nearest * lines[i].fall_along >= -slack)) return 0;
    }
    return edge;
}

// Returns the triangle of a pixel, or kNoTriangle. The argument `pixel` has the four rasterization values of the pixel:
// u, v, z/w and id.
FOURD_HD static inline int triangle_at(const Mesh& mesh, const float* pixel) {
    const int triangle = triangle_of_value(pixel[3]);
    return triangle >= 0 && static_cast<std::size_t>(triangle) < mesh.triangle_count ? triangle : kNoTriangle;
}

// Returns true if the second pixel's triangle `two` is nearer than the first pixel's triangle `one`. At equal depths,
// the triangle with the smaller index counts as nearer.
FOURD_HD static inline bool second_is_nearer(const float* first, int one, const float* second, int two) {
    if (one == kNoTriangle || two == kNoTriangle) return one == kNoTriangle;
    return second[2] < first[2] || (second[2] == first[2] && two < one);
}

// A silhouette edge that crosses a pair, and how blending changes one pixel of the pair. The position of the crossing
// is its distance from the owner's centre, in pixels.
struct Crossing {
    int vertex[2];        // Indices of the ends of the edge.
    Vertex slope[2];      // Derivatives of the crossing's position with respect to x, y and w of each end of the edge.
    float weight;         // In [0, 0.5]. Blending adds weight * (source colour - own colour) to the changed pixel.
    bool changes_owner;   // Whether the changed pixel is the owner. The source is the other pixel of the pair.
    bool differentiable;  // Whether all slopes are finite and at most kMaxSlope.
};

FOURD_HD static inline Crossing crossing_of(const Mesh& mesh, std::size_t first_vertex, const Sight& sight,
                                            int triangle, int edge_number) {
    const int* of = mesh.triangles + 3 * static_cast<std::size_t>(triangle);
    const int i = edge_number - 1;
    Crossing out;
    out.vertex[0] = of[(i + 1) % 3];
    out.vertex[1] = of[(i + 2) % 3];
    const Seen p = see(sight, vertex_at(mesh, first_vertex, out.vertex[0]));
    const Seen q = see(sight, vertex_at(mesh, first_vertex, out.vertex[1]));
    const Line line(sight, p, q);
    const float at = line.value / line.fall_along;
    const float clamped = at < 0 ? 0.0f : (at > 1 ? 1.0f : at);
    out.changes_owner = clamped < 0.5f;
    out.weight = out.changes_owner ? 0.5f - clamped : clamped - 0.5f;
    const float shift = at * sight.step_along;
    const float scale = 1.0f / line.fall_along;
    const Seen to_p{q.b * scale, (shift * q.w - q.a) * scale, -shift * q.b * scale};
    const Seen to_q{-p.b * scale, (p.a - shift * p.w) * scale, shift * p.b * scale};
    const Seen* to[2] = {&to_p, &to_q};
    out.differentiable = true;
    for (int k = 0; k < 2; ++k) {
        const float w = to[k]->w - sight.along * to[k]->a - sight.across * to[k]->b;
        out.slope[k] = sight.axis == 0 ? Vertex{to[k]->a, to[k]->b, w} : Vertex{to[k]->b, to[k]->a, w};
        const float sizes[3] = {magnitude(to[k]->a), magnitude(to[k]->b), magnitude(w)};
        for (const float size : sizes) out.differentiable = out.differentiable && size <= kMaxSlope;
    }
    return out;
}

}  // namespace fourd::antialias
