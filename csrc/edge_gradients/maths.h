// The maths of the lines along which two triangles intersect. The functions find the point where an intersection line
// crosses the segment between the centres of two neighbouring pixels, and the derivatives of this point with respect to
// the vertices.
//
// Vertex i of a triangle has the clip coordinates (x_i, y_i, z_i, w_i), and N_i is the linear function
// (antialias/maths.h) that is 0 on the edge opposite to this vertex. V, the sum of N_i w_i over the three vertices, is
// the same at all pixels. At a pixel, z/w of the triangle is the sum of b_i z_i over the three vertices, where
//     b_i = N_i / V.
// Let f = (f_x, f_y) be a pixel centre in normalised device coordinates. If the two pixels are neighbours in a row, let
// (f_a, f_b) = (f_x, f_y). If they are neighbours in a column, let (f_a, f_b) = (f_y, f_x). N_i is linear in f, so z/w
// is also a linear function of f, with constant coefficients p_a, p_b and p_w:
//     D(f) = p_a f_a + p_b f_b + p_w
// Let dx, dy, dz and dw be small changes of the clip coordinates of vertex i, and let (da, db) be (dx, dy) for
// neighbours in a row, and (dy, dx) for neighbours in a column. These changes of the vertex change D(f) by
//     b_i * (dz - p_a da - p_b db - p_w dw).
// The crossing is the point of the segment at which both triangles have the same D(f).
#pragma once

#include "antialias/maths.h"

namespace fourd::edge_gradients {

using antialias::Line;
using antialias::magnitude;
using antialias::Mesh;
using antialias::Sight;
using antialias::Vertex;

// Maximum number of vertices on which a crossing depends: the vertices of two triangles.
constexpr int kMaxVertices = 6;

struct Position {
    float x, y, z, w;
};

// The derivatives of the distance, in pixels, from the owner of a pair (the pixel whose triangle is nearer) to the
// crossing, with respect to the positions of up to kMaxVertices vertices. If one derivative is not finite or is above
// kMaxSlope, all derivatives are 0.
struct Motion {
    int count = 0;
    int vertex[kMaxVertices];
    Position slope[kMaxVertices];
};

FOURD_HD static inline bool is_valid(const Mesh& mesh, int triangle) {
    const int* of = mesh.triangles + 3 * static_cast<std::size_t>(triangle);
    return mesh.has(of[0]) && mesh.has(of[1]) && mesh.has(of[2]);
}

// Returns true if two triangles share an edge. Such triangles intersect only along this edge, so the kernel does not
// search for an intersection.
FOURD_HD static inline bool share_an_edge(const Mesh& mesh, int one, int two) {
    const int* p = mesh.triangles + 3 * static_cast<std::size_t>(one);
    const int* q = mesh.triangles + 3 * static_cast<std::size_t>(two);
    int common = 0;
    for (int i = 0; i < 3; ++i) common += (p[i] == q[0]) | (p[i] == q[1]) | (p[i] == q[2]);
    return common >= 2;
}

// A triangle with valid vertex indices, in coordinates relative to the owner of a pair (the pixel whose triangle is
// nearer).
struct Outline {
    antialias::Seen seen[3];
    float z[3];
    float value[3], fall[3], fall_across[3];  // The members of antialias::Line for each edge.

    FOURD_HD FOURD_INLINE Outline(const Mesh& mesh, std::size_t first_vertex, const Sight& sight, int triangle) {
        const int* of = mesh.triangles + 3 * static_cast<std::size_t>(triangle);
        for (int k = 0; k < 3; ++k) {
            seen[k] = antialias::see(sight, antialias::vertex_at(mesh, first_vertex, of[k]));
            z[k] = mesh.positions[4 * (first_vertex + of[k]) + 2];
        }
        for (int i = 0; i < 3; ++i) {
            const Line line(sight, seen[(i + 1) % 3], seen[(i + 2) % 3]);
            value[i] = line.value, fall[i] = line.fall_along, fall_across[i] = line.fall_across;
        }
    }

    // Returns true if the triangle contains the centres of both pixels.
    FOURD_HD FOURD_INLINE bool contains_pair() const {
        const float sign = value[0] + value[1] + value[2] < 0 ? -1.0f : 1.0f;
        for (int i = 0; i < 3; ++i) {
            if (!(value[i] * sign >= 0 && (value[i] - fall[i]) * sign >= 0)) return false;
        }
        return true;
    }
};

// z/w of a triangle as a linear function: its value `depth` at the owner, and its decreases per pixel along and across
// the pair. `volume` is V (see the top of this file).
struct Plane {
    float volume, depth, fall, fall_across;

    FOURD_HD FOURD_INLINE explicit Plane(const Outline& of)
        : volume(of.value[0] * of.seen[0].w + of.value[1] * of.seen[1].w + of.value[2] * of.seen[2].w),
          depth(sum(of.value, of.z) / volume),
          fall(sum(of.fall, of.z) / volume),
          fall_across(sum(of.fall_across, of.z) / volume) {}

    FOURD_HD FOURD_INLINE static float sum(const float* lines, const float* z) {
        return lines[0] * z[0] + lines[1] * z[1] + lines[2] * z[2];
    }
};

// Returns true if the line along which two triangles intersect crosses the segment between the centres of two pixels.
// The owner is the pixel whose triangle (of_owner) is nearer, if the depth of each pixel's triangle is taken at the
// centre of that pixel. Both triangles must contain both centres. At the owner's centre, of_owner must not be behind
// of_other, and at the other centre, of_owner must not be in front of of_other. An intersection line is ignored if its
// angle to the segment is below 45 degrees, which is the rule of antialias::crossed_edge() for silhouette edges.
FOURD_HD static inline bool intersect(const Mesh& mesh, std::size_t first_vertex, const Sight& sight, int of_owner,
                                      int of_other) {
    const Outline second(mesh, first_vertex, sight, of_other);
    if (!second.contains_pair()) return false;
    const Outline first(mesh, first_vertex, sight, of_owner);
    if (!first.contains_pair()) return false;
    const Plane one(first), two(second);
    const float gap = one.depth - two.depth, growth = two.fall - one.fall;
    const float across = magnitude(two.fall_across - one.fall_across);
    const bool perpendicular = sight.axis == 0 ? growth >= across : growth > across;
    return perpendicular && growth > 0 && gap <= 0 && gap + growth >= 0;
}

FOURD_HD static inline Position position_of(const Sight& sight, float along, float across, float z, float w) {
    return sight.axis == 0 ? Position{along, across, z, w} : Position{across, along, z, w};
}

FOURD_HD static inline bool is_moderate(const Position& slope) {
    return magnitude(slope.x) <= antialias::kMaxSlope && magnitude(slope.y) <= antialias::kMaxSlope &&
           magnitude(slope.z) <= antialias::kMaxSlope && magnitude(slope.w) <= antialias::kMaxSlope;
}

// Returns the derivatives of the crossing's position, for two triangles for which intersect() is true.
FOURD_HD static inline Motion motion_of_intersection(const Mesh& mesh, std::size_t first_vertex, const Sight& sight,
                                                     int of_owner, int of_other) {
    const Outline outlines[2] = {Outline(mesh, first_vertex, sight, of_owner),
                                 Outline(mesh, first_vertex, sight, of_other)};
    const Plane planes[2] = {Plane(outlines[0]), Plane(outlines[1])};
    const float growth = planes[1].fall - planes[0].fall;
    const float at = (planes[1].depth - planes[0].depth) / growth;
    Motion out;
    out.count = kMaxVertices;
    bool moderate = true;
    for (int k = 0; k < kMaxVertices; ++k) {
        const int which = k / 3, i = k % 3;
        const Outline& outline = outlines[which];
        const Plane& plane = planes[which];
        const float to_along = -plane.fall / sight.step_along, to_across = -plane.fall_across / sight.step_across;
        const float here = sight.along + at * sight.step_along;
        const float to_w = plane.depth - at * plane.fall - to_along * here - to_across * sight.across;
        const float share = (outline.value[i] - at * outline.fall[i]) / (plane.volume * (which == 0 ? -growth : growth));
        out.vertex[k] = mesh.triangles[3 * static_cast<std::size_t>(which == 0 ? of_owner : of_other) + i];
        out.slope[k] = position_of(sight, -share * to_along, -share * to_across, share, -share * to_w);
        moderate = moderate && is_moderate(out.slope[k]);
    }
    for (int k = 0; k < kMaxVertices && !moderate; ++k) out.slope[k] = {0, 0, 0, 0};
    return out;
}

FOURD_HD static inline Motion motion_of_silhouette(const Mesh& mesh, std::size_t first_vertex, const Sight& sight,
                                                   int of_owner, int edge_number) {
    const antialias::Crossing crossing = antialias::crossing_of(mesh, first_vertex, sight, of_owner, edge_number);
    Motion out;
    out.count = 2;
    for (int k = 0; k < 2; ++k) {
        const Vertex& slope = crossing.slope[k];
        out.vertex[k] = crossing.vertex[k];
        out.slope[k] = crossing.differentiable ? Position{slope.x, slope.y, 0, slope.w} : Position{0, 0, 0, 0};
    }
    return out;
}

}  // namespace fourd::edge_gradients
