// The pairs of neighbouring pixels between which a visibility edge (edge_gradients.h) lies.
#pragma once

#include "antialias/pairs.h"
#include "edge_gradients/maths.h"

namespace fourd::edge_gradients {

using antialias::Code;
using antialias::kBitsPerPair;
using antialias::Pair;
using antialias::Plan;
using antialias::Rows;
using antialias::View;

// The codes are those of antialias/maths.h, with one additional value per pair: if the lower two of a pair's three bits
// are 0 and the third bit is 1, the triangles of the two pixels intersect.
FOURD_HD static inline Code intersection_code(int axis) { return antialias::code_of(0, true, axis); }
FOURD_HD static inline bool is_intersection(Code code, int axis) {
    return antialias::edge_of(code, axis) == 0 && antialias::owner_is_neighbour(code, axis);
}
FOURD_HD static inline int vertices_of(Code code, int axis) {
    return is_intersection(code, axis) ? kMaxVertices : (antialias::edge_of(code, axis) != 0 ? 2 : 0);
}

// Returns the derivative of the loss with respect to the distance of the edge from the pixel `owner`, whose triangle is
// nearer to the camera. If the edge moves by dt pixels away from the owner, the colour of one of the two pixels changes
// by dt * (colour of the owner - colour of the other pixel). Because the image without antialiasing does not show which
// of the two pixels this is, the result is the mean of the derivatives for both cases.
FOURD_HD static inline float change(const View& view, std::size_t owner, std::size_t other, const float* gradient) {
    const std::size_t one = owner * view.channels, two = other * view.channels;
    const float* colours = view.plan.images.colours;
    float sum = 0;
    for (int c = 0; c < view.channels; ++c) {
        sum += (gradient[one + c] + gradient[two + c]) * (colours[one + c] - colours[two + c]);
    }
    return 0.5f * sum;
}

// Returns the code of a pair, or 0 if the pair has no visibility edge or the loss does not depend on the position of
// the edge.
FOURD_HD static inline Code find_edge(const View& view, const Pair& pair, const float* gradient) {
    const std::size_t first = view.pixel(pair.row, pair.column), second = view.neighbour(first, pair.axis);
    const Mesh& mesh = view.plan.mesh;
    const int one = antialias::triangle_at(mesh, view.rast(first)), two = antialias::triangle_at(mesh, view.rast(second));
    if (one == two) return 0;
    const bool can_intersect = one != kNoTriangle && two != kNoTriangle && !share_an_edge(mesh, one, two);
    if (!can_intersect && (one == kNoTriangle || view.silhouettes[one] == 0) &&
        (two == kNoTriangle || view.silhouettes[two] == 0)) {
        return 0;
    }
    if (change(view, first, second, gradient) == 0) return 0;
    const Code code = antialias::analyse(view, pair);
    if (code != 0 || !can_intersect || !is_valid(mesh, one) || !is_valid(mesh, two)) return code;
    const bool is_second = antialias::second_is_nearer(view.rast(first), one, view.rast(second), two);
    const Sight sight(pair, is_second, view.height, view.width);
    const bool found = intersect(mesh, view.first_vertex, sight, is_second ? two : one, is_second ? one : two);
    return found ? intersection_code(pair.axis) : 0;
}

// Calls add(vertex, x, y, z, w) for each vertex that moves the visibility edge of a pair. The arguments x, y, z and w
// are the gradient of the loss with respect to the clip coordinates of the vertex. The code of the pair must not be 0.
template <typename Add>
FOURD_HD FOURD_INLINE void for_motion(const View& view, const Pair& pair, Code code, const float* gradient,
                                      const Add& add) {
    const std::size_t first = view.pixel(pair.row, pair.column), second = view.neighbour(first, pair.axis);
    const Mesh& mesh = view.plan.mesh;
    const int one = antialias::triangle_at(mesh, view.rast(first)), two = antialias::triangle_at(mesh, view.rast(second));
    const bool intersection = is_intersection(code, pair.axis);
    const bool is_second = intersection ? antialias::second_is_nearer(view.rast(first), one, view.rast(second), two)
                                        : antialias::owner_is_neighbour(code, pair.axis);
    const Sight sight(pair, is_second, view.height, view.width);
    const int of_owner = is_second ? two : one, of_other = is_second ? one : two;
    const Motion motion =
        intersection
            ? motion_of_intersection(mesh, view.first_vertex, sight, of_owner, of_other)
            : motion_of_silhouette(mesh, view.first_vertex, sight, of_owner, antialias::edge_of(code, pair.axis));
    const float factor = change(view, is_second ? second : first, is_second ? first : second, gradient);
    for (int k = 0; k < motion.count; ++k) {
        const Position& slope = motion.slope[k];
        add(view.first_vertex + motion.vertex[k], factor * slope.x, factor * slope.y, factor * slope.z,
            factor * slope.w);
    }
}

}  // namespace fourd::edge_gradients
