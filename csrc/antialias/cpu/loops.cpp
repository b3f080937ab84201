// For speed, the loops first skip most pairs of pixels: those that show the same triangle, or two triangles without
// silhouette edges.
#include "antialias/cpu/loops.h"

#include <cstdint>
#include <cstring>

#include "antialias/pairs.h"
#include "common/inline.h"

namespace fourd::antialias::FOURD_SIMD {
namespace {

void silhouettes(const Mesh& mesh, std::size_t instance, std::size_t begin, std::size_t end, std::uint8_t* out) {
    const std::size_t first_vertex = mesh.first_vertex(instance);
    for (std::size_t triangle = begin; triangle < end; ++triangle) {
        out[instance * mesh.triangle_count + triangle] = silhouettes_of(mesh, first_vertex, triangle);
    }
}

#include "antialias/cpu/changes.inc"

// Copies elements [begin, end).
FOURD_INLINE void copy(const float* from, std::size_t begin, std::size_t end, float* to) {
    if (begin != end) std::memcpy(to + begin, from + begin, (end - begin) * sizeof(float));
}

FOURD_INLINE void blend_pair(const View& view, const Pair& pair, Code code, std::size_t end_pixel, std::size_t begin_pixel,
                             float* out) {
    const Blend blend(view, pair, code);
    if (blend.changed < begin_pixel || blend.changed >= end_pixel) return;
    const float* from = view.plan.images.colours + blend.source * view.channels;
    const float* at = view.plan.images.colours + blend.changed * view.channels;
    float* to = out + blend.changed * view.channels;
    for (int c = 0; c < view.channels; ++c) to[c] += blend.crossing.weight * (from[c] - at[c]);
}

void blend(const Plan& plan, const Rows& rows, float* scratch, float* out, std::uint8_t* codes) {
    const View view(plan, rows.image);
    const std::size_t begin = view.pixel(rows.begin, 0), end = view.pixel(rows.end, 0);
    float *ids = scratch, *below = scratch + view.width;
    std::uint8_t* const changes = reinterpret_cast<std::uint8_t*>(scratch + 2 * static_cast<std::size_t>(view.width));
    copy(plan.images.colours, begin * view.channels, end * view.channels, out);
    // The loop starts at row rows.begin - 1, because the pixels of this row form pairs with the pixels of row
    // rows.begin. Blending can change either pixel of a pair.
    const int first = rows.begin > 0 ? rows.begin - 1 : 0;
    copy_ids(view.rast(view.pixel(first, 0)), view.width, below);
    for (int row = first; row < rows.end; ++row) {
        float* const swapped = ids;
        ids = below, below = swapped;
        const bool has_below = row + 1 < view.height;
        if (has_below) copy_ids(view.rast(view.pixel(row + 1, 0)), view.width, below);
        find_changes(ids, has_below ? below : nullptr, view.width, changes);
        const bool own = row >= rows.begin;
        std::uint8_t* const row_codes = codes + view.pixel(row, 0);
        if (own) std::memset(row_codes, 0, view.width);
        for_nonzero(changes, view.width, [&](int column) FOURD_INLINE_LAMBDA {
            Code code = 0;
            for (int axis = own ? 0 : 1; axis < 2; ++axis) {
                if ((changes[column] >> axis & 1) == 0) continue;
                const Pair pair{row, column, axis};
                const Code found = analyse(view, pair);
                if (found != 0) blend_pair(view, pair, found, end, begin, out);
                code |= found;
            }
            if (own) row_codes[column] = static_cast<std::uint8_t>(code);
        });
    }
}

std::size_t count(const Plan& plan, const Rows& rows, const std::uint8_t* codes) {
    const View view(plan, rows.image);
    const std::uint8_t* const from = codes + view.pixel(rows.begin, 0);
    std::size_t crossings = 0;
    for_nonzero(from, (rows.end - rows.begin) * view.width, [&](int i) FOURD_INLINE_LAMBDA {
        crossings += static_cast<std::size_t>((edge_of(from[i], 0) != 0) + (edge_of(from[i], 1) != 0));
    });
    return crossings;
}

FOURD_INLINE void contribute(const View& view, const Blend& blend, const Gradients& gradients,
                             Contribution* contributions) {
    const float factor = crossing_gradient(view, blend, gradients.gradient) * gradients.boost;
    for (int k = 0; k < 2; ++k) {
        const Vertex& slope = blend.crossing.slope[k];
        const std::uint32_t vertex = static_cast<std::uint32_t>(view.first_vertex + blend.crossing.vertex[k]);
        if (blend.crossing.differentiable) {
            contributions[k] = {vertex, factor * slope.x, factor * slope.y, factor * slope.w};
        } else {
            contributions[k] = {vertex, 0, 0, 0};
        }
    }
}

FOURD_INLINE void move_gradient(const View& view, const Blend& blend, std::size_t begin, std::size_t end,
                                const Gradients& gradients) {
    const float* upstream = gradients.gradient + blend.changed * view.channels;
    for (int side = 0; side < 2; ++side) {
        const bool to_source = side == 1;
        const std::size_t pixel = to_source ? blend.source : blend.changed;
        if (pixel < begin || pixel >= end) continue;
        float* to = gradients.colours + pixel * view.channels;
        const float weight = to_source ? blend.crossing.weight : -blend.crossing.weight;
        for (int c = 0; c < view.channels; ++c) to[c] += weight * upstream[c];
    }
}

void blend_backward(const Plan& plan, const Rows& rows, const Gradients& gradients, Contribution* contributions) {
    const View view(plan, rows.image);
    const std::size_t begin = view.pixel(rows.begin, 0), end = view.pixel(rows.end, 0);
    if (gradients.colours) {
        copy(gradients.gradient, begin * view.channels, end * view.channels, gradients.colours);
    }
    for (int row = rows.begin > 0 ? rows.begin - 1 : 0; row < rows.end; ++row) {
        const bool own = row >= rows.begin;
        const std::uint8_t* const codes = gradients.codes + view.pixel(row, 0);
        for_nonzero(codes, view.width, [&](int column) FOURD_INLINE_LAMBDA {
            for (int axis = own ? 0 : 1; axis < 2; ++axis) {
                if (edge_of(codes[column], axis) == 0) continue;
                const Pair pair{row, column, axis};
                if (!has_owner(view, pair, codes[column])) {
                    // count() counts two contributions for every pair whose code has an edge. If the code is invalid,
                    // so that has_owner() is false, both contributions are 0.
                    if (own && contributions) *contributions++ = {0, 0, 0, 0}, *contributions++ = {0, 0, 0, 0};
                    continue;
                }
                const Blend blend(view, pair, codes[column]);
                if (gradients.colours) move_gradient(view, blend, begin, end, gradients);
                if (!own || !contributions) continue;
                contribute(view, blend, gradients, contributions);
                contributions += 2;
            }
        });
    }
}

void scatter(const Contribution* contributions, std::size_t count, std::size_t begin, std::size_t end,
             float* positions) {
    if (begin == end) return;
    std::memset(positions + 4 * begin, 0, 4 * (end - begin) * sizeof(float));
    for (std::size_t i = 0; i < count; ++i) {
        const Contribution& one = contributions[i];
        if (one.vertex < begin || one.vertex >= end) continue;
        float* to = positions + 4 * static_cast<std::size_t>(one.vertex);
        to[0] += one.x, to[1] += one.y, to[3] += one.w;
    }
}

}  // namespace

const Loops loops = {silhouettes, blend, count, blend_backward, scatter};

}  // namespace fourd::antialias::FOURD_SIMD
