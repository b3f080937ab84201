// Compositing of discs along rays. A disc faces each ray, or all discs are parallel to a plane. With discs parallel to
// the image plane of a pinhole camera, the result along its rays is that of the compositor of points (points/points.h).
#pragma once

#include <cstddef>
#include <cstdint>

#include "rays/rays.h"

namespace fourd::rays {

constexpr int kMaxDiscLayers = 64;

struct Discs {
    const float* xyz;      // (count, 3).
    const float* radius;   // (count,).
    const float* density;  // (count,). The alpha at the centre, clamped to 1.
    std::size_t count;
};

struct alignas(64) DiscBlock {
    float centre[3][kWidth];
    float inverse_square[kWidth];  // 1 / radius^2.
    float density[kWidth];         // 0 where there is no disc.
    std::int32_t index[kWidth];
    std::int32_t unused[2][kWidth];
};

struct DiscTree {
    Buffer<Node> nodes;
    Buffer<DiscBlock> blocks;
    float magnitude = 0.0f;  // The largest absolute coordinate of the boxes of all discs that can be hit.
};

struct DiscTreeView {
    const Node* nodes;
    std::size_t node_count;
    const DiscBlock* blocks;
    float magnitude;
};

// Builds a tree, which is the same for any number of threads. Discs are never hit if a number is not finite, or if
// radius or density is not positive.
DiscTree build_discs(const Discs& discs, int threads);

struct DiscPicture {
    const float* colours;  // (Discs::count, 3), of the discs that the tree was built for.
    const float* facing;   // (3,): normal of all discs. Null if each disc faces the ray.
    int layers;            // Number K of nearest discs that are composited, from 1 to kMaxDiscLayers.
    float* rgba;           // (Rays::count, 4): colour times alpha, and alpha.
};

// Composites the K nearest discs of each ray front to back, in the order of (t, index). The alpha of a disc at the
// distance d from its centre is density (1 - d^2 / radius^2). Rays::after_t and after_triangle are ignored.
void composite_discs(const DiscTreeView& tree, const Rays& rays, const DiscPicture& picture);

}  // namespace fourd::rays
