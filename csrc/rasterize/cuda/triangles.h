// Access to triangles, and the depth test of pixels, in the kernels of the rasterizer.
#pragma once

#include <cstring>

#include "device/lane.h"
#include "rasterize/clipping.h"
#include "rasterize/rasterize.h"

namespace fourd::rasterize::cuda {

// A triangle of an image, with its clip coordinates.
struct Triangle {
    int index;
    const float* corners[3];
    Snapped snapped[3];

    FOURD_DEVICE bool is_clipped() const { return !all_inside(snapped[0], snapped[1], snapped[2]); }
};

// Loads a triangle. Returns false if one of its vertex indices is out of range.
FOURD_DEVICE static inline bool load_triangle(const Query& query, const Screen& screen, std::size_t image,
                                              std::size_t triangle, Triangle* out) {
    const float* const pos = query.pos_of(image);
    out->index = static_cast<int>(triangle);
    for (int k = 0; k < 3; ++k) {
        const std::size_t vertex = static_cast<std::uint32_t>(query.tri[3 * triangle + k]);
        if (vertex >= query.vertices) return false;
        out->corners[k] = pos + 4 * vertex;
        out->snapped[k] = snap(screen, out->corners[k]);
    }
    return true;
}

template <typename Take>
FOURD_DEVICE static inline void for_pieces_of(const Screen& screen, const Triangle& triangle, const Take& take) {
    for_pieces(screen, triangle.snapped[0], triangle.snapped[1], triangle.snapped[2], triangle.corners[0],
               triangle.corners[1], triangle.corners[2], triangle.index, take);
}

FOURD_DEVICE static inline Planes planes_of(const Screen& screen, const Triangle& triangle, int column, int row) {
    return make_planes(screen, triangle.corners[0], triangle.corners[1], triangle.corners[2], column, row);
}

// A pixel stores its nearest triangle as a 64-bit key, with the depth in the upper bits and the index of the triangle
// in the lower bits. Of two triangles, the nearer one has the smaller key.
constexpr std::uint64_t kNoHit = ~std::uint64_t{0};

FOURD_DEVICE static inline std::uint64_t key_of(float depth, int triangle) {
    std::uint32_t bits;
    memcpy(&bits, &depth, sizeof bits);
    bits = bits & 0x80000000u ? ~bits : bits | 0x80000000u;
    return std::uint64_t{bits} << 32 | static_cast<std::uint32_t>(triangle);
}

FOURD_DEVICE static inline float depth_of(std::uint64_t key) {
    std::uint32_t bits = static_cast<std::uint32_t>(key >> 32);
    bits = bits & 0x80000000u ? bits & 0x7fffffffu : ~bits;
    float depth;
    memcpy(&depth, &bits, sizeof depth);
    return depth;
}

// The buffer to which the kernels write the nearest triangle of each pixel. If `previous` is not null, the kernels
// write the nearest of the triangles that are behind the pixel's triangle in `previous` (depth peeling). Of two
// triangles at the same depth, the one with the larger index counts as behind the other one.
struct Target {
    Screen screen;
    std::uint64_t* keys;    // Shape (images, height, width).
    const float* previous;  // Shape (images, height, width, 4): `rast` of the previous layer, or null.

    FOURD_DEVICE std::size_t pixel(std::size_t image, int column, int row) const {
        return (image * screen.height + row) * screen.width + column;
    }

    // Tests whether a piece covers a pixel, and records the piece's triangle if it is the nearest so far.
    FOURD_DEVICE void test(const Piece& piece, const Planes& planes, std::size_t image, int column, int row) const {
        for (int k = 0; k < 3; ++k) {
            if (edge_of(piece, k, column, row).value < 0) return;
        }
        const float dx = static_cast<float>(column - piece.reference_x);
        const float dy = static_cast<float>(row - piece.reference_y);
        const float depth = clamp_depth(plane_at(planes.c[3], planes.x[3], planes.y[3], dx, dy), planes.low,
                                        planes.high);
        if (!(depth >= -1.0f && depth <= 1.0f)) return;
        const std::size_t at = pixel(image, column, row);
        if (previous != nullptr) {
            const float before = previous[4 * at + 2], before_id = previous[4 * at + 3];
            // A pixel that shows the background in the previous layer has no further layers.
            if (!(before_id > 0.0f)) return;
            const bool is_behind =
                depth > before || (depth == before && value_of_triangle(piece.triangle) > before_id);
            if (!is_behind) return;
        }
        device::atomic_min(keys + at, key_of(depth, piece.triangle));
    }
};

}  // namespace fourd::rasterize::cuda
