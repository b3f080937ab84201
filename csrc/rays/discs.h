// Compositing of discs along rays. The normal of the discs is either the direction of the current ray, or one vector
// for all rays. If the discs are parallel to the image plane of a pinhole camera, and there is one ray for each pixel,
// the result equals the image of the point renderer (points/points.h).
#pragma once

#include <cstddef>
#include <cstdint>

#include "rays/rays.h"

namespace fourd::rays {

constexpr int kMaxDiscLayers = 64;

struct Discs {
    const float* xyz;      // Shape (count, 3).
    const float* radius;   // Shape (count,).
    const float* density;  // Shape (count,): alpha at the centre of each disc, clamped to 1.
    std::size_t count;
};

struct alignas(64) DiscBlock {
    float centre[3][kWidth];
    float inverse_square[kWidth];  // 1 / radius^2.
    float density[kWidth];         // 0 in unused elements, which have no disc.
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

// Builds a tree, which is the same for any number of threads. A disc is never hit if its centre, radius or density is
// not finite, or if its radius or density is not positive.
DiscTree build_discs(const Discs& discs, int threads);

struct DiscPicture {
    const float* colours;  // Shape (Discs::count, 3): colours of the discs for which the tree was built.
    const float* facing;   // Shape (3,): the normal of all discs, or null to use each ray's direction.
    int layers;            // Maximum number of discs that are composited per ray, from 1 to kMaxDiscLayers.
    float* rgba;           // Shape (Rays::count, 4): colour multiplied by alpha, then alpha.
};

// Composites, for each ray, the discs that the ray hits. The order is front to back: by t, then by index. If a ray hits
// more than picture.layers discs, only the first picture.layers of them are used. The alpha of a disc at the distance d
// from its centre is density * (1 - d^2 / radius^2). Rays::after_t and after_triangle are ignored.
void composite_discs(const DiscTreeView& tree, const Rays& rays, const DiscPicture& picture);

}  // namespace fourd::rays
