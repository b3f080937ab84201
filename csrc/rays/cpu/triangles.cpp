// Trees over triangles.
#include <algorithm>
#include <vector>

#include "rays/cpu/topology.h"
#include "rays/maths.h"

namespace fourd::rays {
namespace {

constexpr std::size_t kTrianglesPerTask = 8192;
constexpr std::size_t kBlocksPerTask = 1024;

inline void extend(Box* box, const float* at) {
    for (int axis = 0; axis < 3; ++axis) {
        box->low[axis] = std::min(box->low[axis], at[axis]);
        box->high[axis] = std::max(box->high[axis], at[axis]);
    }
}

Buffer<Reference> references_of(const Mesh& mesh, Team& team) {
    Buffer<Reference> out(mesh.triangles);
    run_parts(team, mesh.triangles, kTrianglesPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            Reference& reference = out[i];
            reference.box = kEmptyBox;
            reference.index = static_cast<std::int32_t>(i);
            std::size_t corners[3];
            bool is_valid = mesh.find(reference.index, corners);
            for (std::size_t k = 0; is_valid && k < 3; ++k) {
                const float* const at = mesh.xyz + 3 * corners[k];
                for (int axis = 0; axis < 3; ++axis) is_valid = is_valid && absolute(at[axis]) <= kMaxMagnitude;
                extend(&reference.box, at);
            }
            // A triangle with invalid coordinates cannot be hit, but is still part of the tree, because its coordinates
            // may be valid when refit() updates the tree.
            if (!is_valid) reference.box = {};
        }
    });
    return out;
}

// Writes the corners of the block's triangles, and returns the bounding box of the triangles.
LeafBox move_block(const Mesh& mesh, Block* block) {
    LeafBox box = kEmptyLeafBox;
    for (int lane = 0; lane < kWidth; ++lane) {
        const std::int32_t triangle = block->triangle[lane];
        std::size_t corners[3] = {0, 0, 0};
        bool is_valid = mesh.find(triangle, corners);
        for (std::size_t k = 0; is_valid && k < 3; ++k) {
            const float* const at = mesh.xyz + 3 * corners[k];
            for (int axis = 0; axis < 3; ++axis) is_valid = is_valid && absolute(at[axis]) <= kMaxMagnitude;
        }
        for (int k = 0; k < 3; ++k) {
            for (int axis = 0; axis < 3; ++axis) {
                const float value = is_valid ? mesh.xyz[3 * corners[k] + axis] : __builtin_nanf("");
                block->corner[k][axis][lane] = value;
                if (value < box.bounds[2 * axis]) box.bounds[2 * axis] = value;
                if (value > box.bounds[2 * axis + 1]) box.bounds[2 * axis + 1] = value;
            }
        }
    }
    return box;
}

}  // namespace

float refit(const Mesh& mesh, Node* nodes, std::size_t node_count, Block* blocks, std::size_t block_count, int threads) {
    Team team(threads);
    std::vector<LeafBox> boxes(block_count);
    run_parts(team, block_count, kBlocksPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) boxes[i] = move_block(mesh, blocks + i);
    });
    return fill_bounds(nodes, node_count, boxes.data());
}

Tree build(const Mesh& mesh, int threads) {
    Topology topology;
    {
        Team team(threads);
        Buffer<Reference> references = references_of(mesh, team);
        topology = build_topology(references.data(), references.size(), team);
    }
    Tree out{std::move(topology.nodes), Buffer<Block>(topology.leaves.size()), 0.0f};
    for (std::size_t i = 0; i < out.blocks.size(); ++i) {
        std::copy_n(topology.leaves[i].index, kWidth, out.blocks[i].triangle);
    }
    out.magnitude = refit(mesh, out.nodes.data(), out.nodes.size(), out.blocks.data(), out.blocks.size(), threads);
    return out;
}

}  // namespace fourd::rays
