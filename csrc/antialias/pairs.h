// Finds the pairs of neighbouring pixels that a silhouette edge crosses, and blends the colours of these pairs.
#pragma once

#include "antialias/antialias.h"
#include "common/inline.h"

namespace fourd::antialias {

struct Plan {
    Mesh mesh;
    Images images;
    const std::uint8_t* silhouettes;  // Shape (instances, triangle_count): results of silhouettes_of().

    FOURD_HD FOURD_INLINE const std::uint8_t* silhouettes_of_image(std::size_t image) const {
        return silhouettes + (mesh.instanced ? image * mesh.triangle_count : 0);
    }
};

// Consecutive rows of one image.
struct Rows {
    std::size_t image;
    int begin, end;
};

// One image of a plan: where its data start in the arrays of the plan, and its size.
struct View {
    Plan plan;
    std::size_t first_pixel, first_vertex;
    const std::uint8_t* silhouettes;
    int height, width, channels;

    FOURD_HD FOURD_INLINE View(const Plan& of, std::size_t image)
        : plan(of),
          first_pixel(image * of.images.pixels()),
          first_vertex(of.mesh.first_vertex(image)),
          silhouettes(of.silhouettes ? of.silhouettes_of_image(image) : nullptr),
          height(of.images.height),
          width(of.images.width),
          channels(of.images.channels) {}

    FOURD_HD FOURD_INLINE std::size_t pixel(int row, int column) const {
        return first_pixel + static_cast<std::size_t>(row) * width + column;
    }
    FOURD_HD FOURD_INLINE std::size_t neighbour(std::size_t pixel, int axis) const { return pixel + (axis == 0 ? 1 : width); }
    FOURD_HD FOURD_INLINE const float* rast(std::size_t pixel) const { return plan.images.rast + 4 * pixel; }
};

// Returns the three bits of a Code (maths.h) that describe one pair of pixels, or 0 if no silhouette edge crosses the
// pair.
FOURD_HD static inline Code analyse(const View& view, const Pair& pair) {
    const std::size_t first = view.pixel(pair.row, pair.column), second = view.neighbour(first, pair.axis);
    const Mesh& mesh = view.plan.mesh;
    const int one = triangle_at(mesh, view.rast(first)), two = triangle_at(mesh, view.rast(second));
    if (one == two) return 0;
    const unsigned of_one = one == kNoTriangle ? 0u : view.silhouettes[one];
    const unsigned of_two = two == kNoTriangle ? 0u : view.silhouettes[two];
    if ((of_one | of_two) == 0) return 0;
    const bool is_second = second_is_nearer(view.rast(first), one, view.rast(second), two);
    const unsigned silhouettes = is_second ? of_two : of_one;
    if (silhouettes == 0) return 0;
    const Sight sight(pair, is_second, view.height, view.width);
    const int edge = crossed_edge(mesh, view.first_vertex, sight, is_second ? two : one, silhouettes);
    return edge == 0 ? 0 : code_of(edge, is_second, pair.axis);
}

// Returns true if the second pixel of the pair is inside the image, and the pair's owner shows a triangle with valid
// vertex indices. The owner is the pixel with the nearer triangle, according to `code`. The result is always true for a
// code that is not 0 and comes from analyse(), but the bindings do not check codes, so a caller can pass arbitrary
// codes to the backward kernels.
FOURD_HD static inline bool has_owner(const View& view, const Pair& pair, Code code) {
    if (pair.axis == 0 ? pair.column + 1 >= view.width : pair.row + 1 >= view.height) return false;
    const std::size_t first = view.pixel(pair.row, pair.column);
    const Mesh& mesh = view.plan.mesh;
    const int triangle =
        triangle_at(mesh, view.rast(owner_is_neighbour(code, pair.axis) ? view.neighbour(first, pair.axis) : first));
    if (triangle == kNoTriangle) return false;
    const int* of = mesh.triangles + 3 * static_cast<std::size_t>(triangle);
    return mesh.has(of[0]) && mesh.has(of[1]) && mesh.has(of[2]);
}

// A crossing, the pixel whose colour changes, and the source pixel that is blended into it.
struct Blend {
    Crossing crossing;
    std::size_t changed, source;
    float towards_source;  // 1 if the weight of the source increases when the crossing moves away from the owner, and
                           // -1 if it decreases.

    FOURD_HD FOURD_INLINE Blend(const View& view, const Pair& pair, Code code) {
        const std::size_t first = view.pixel(pair.row, pair.column), second = view.neighbour(first, pair.axis);
        const bool is_second = owner_is_neighbour(code, pair.axis);
        const std::size_t owner = is_second ? second : first, other = is_second ? first : second;
        const Sight sight(pair, is_second, view.height, view.width);
        crossing = crossing_of(view.plan.mesh, view.first_vertex, sight, triangle_of_value(view.rast(owner)[3]),
                               edge_of(code, pair.axis));
        changed = crossing.changes_owner ? owner : other;
        source = crossing.changes_owner ? other : owner;
        towards_source = crossing.changes_owner ? -1.0f : 1.0f;
    }
};

// Returns the derivative of the loss with respect to the distance of the crossing point from the owner's centre, in
// pixels.
FOURD_HD static inline float crossing_gradient(const View& view, const Blend& blend, const float* gradient) {
    const std::size_t changed = blend.changed * view.channels, source = blend.source * view.channels;
    const float* colours = view.plan.images.colours;
    float sum = 0;
    for (int c = 0; c < view.channels; ++c) sum += gradient[changed + c] * (colours[source + c] - colours[changed + c]);
    return sum * blend.towards_source;
}

}  // namespace fourd::antialias
