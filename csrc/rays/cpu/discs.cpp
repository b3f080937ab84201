#include "rays/discs.h"

#include <algorithm>
#include <vector>

#include "common/team.h"
#include "rays/cpu/disc_loops.h"
#include "rays/cpu/topology.h"
#include "rays/maths.h"

namespace fourd::rays {
namespace {

constexpr std::size_t kRaysPerTask = 1024;

// Returns true if the disc can be hit. Comparisons with NaN are false, so a disc with a NaN is never hit.
bool is_visible(const Discs& discs, std::size_t index) {
    const float radius = discs.radius[index];
    bool visible = radius > 1e-18f && radius <= kMaxMagnitude && discs.density[index] > 0.0f &&
                   discs.density[index] <= kMaxMagnitude;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        visible = visible && absolute(discs.xyz[3 * index + axis]) <= kMaxMagnitude / 2 - radius;
    }
    return visible;
}

Buffer<Reference> references_of(const Discs& discs, std::size_t* count) {
    Buffer<Reference> out(discs.count);
    *count = 0;
    for (std::size_t i = 0; i < discs.count; ++i) {
        if (!is_visible(discs, i)) continue;
        Reference& reference = out[(*count)++];
        reference.index = static_cast<std::int32_t>(i);
        reference.box = {};
        for (std::size_t axis = 0; axis < 3; ++axis) {
            reference.box.low[axis] = discs.xyz[3 * i + axis] - discs.radius[i];
            reference.box.high[axis] = discs.xyz[3 * i + axis] + discs.radius[i];
        }
    }
    return out;
}

LeafBox fill_block(const Discs& discs, const Leaf& leaf, DiscBlock* block) {
    LeafBox box = kEmptyLeafBox;
    *block = {};
    for (int lane = 0; lane < kWidth; ++lane) {
        block->index[lane] = leaf.index[lane];
        if (leaf.index[lane] < 0) continue;
        const std::size_t i = static_cast<std::size_t>(leaf.index[lane]);
        const float radius = discs.radius[i];
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const float centre = discs.xyz[3 * i + axis];
            block->centre[axis][lane] = centre;
            box.bounds[2 * axis] = std::min(box.bounds[2 * axis], centre - radius);
            box.bounds[2 * axis + 1] = std::max(box.bounds[2 * axis + 1], centre + radius);
        }
        block->inverse_square[lane] = 1.0f / (radius * radius);
        block->density[lane] = std::min(discs.density[i], 1.0f);
    }
    return box;
}

}  // namespace

DiscTree build_discs(const Discs& discs, int threads) {
    Team team(threads);
    std::size_t count;
    Buffer<Reference> references = references_of(discs, &count);
    Topology topology = build_topology(references.data(), count, team);
    DiscTree out{std::move(topology.nodes), Buffer<DiscBlock>(topology.leaves.size()), 0.0f};
    std::vector<LeafBox> boxes(topology.leaves.size());
    for (std::size_t i = 0; i < boxes.size(); ++i) boxes[i] = fill_block(discs, topology.leaves[i], &out.blocks[i]);
    out.magnitude = fill_bounds(out.nodes.data(), out.nodes.size(), boxes.data());
    return out;
}

void composite_discs(const DiscTreeView& tree, const Rays& rays, const DiscPicture& picture) {
    const discs::Loops& loops = discs::select_loops(rays.simd);
    Team team(rays.threads);
    run_parts(team, rays.count, kRaysPerTask,
              [&](std::size_t begin, std::size_t end) { loops.composite(tree, rays, picture, begin, end); });
}

}  // namespace fourd::rays
