#include <algorithm>
#include <vector>

#include "common/team.h"
#include "rays/maths.h"
#include "rays/rays.h"

namespace fourd::rays {
namespace {

constexpr float kInfinity = __builtin_huge_valf();
constexpr std::size_t kBlocksPerTask = 1024;

struct Box {
    float bounds[6];  // In the order of Node::bounds.
};

constexpr Box kEmptyBox = {{kInfinity, -kInfinity, kInfinity, -kInfinity, kInfinity, -kInfinity}};

// Writes the corners of the block's triangles, and returns their box.
Box move_block(const Mesh& mesh, Block* block) {
    Box box = kEmptyBox;
    for (int lane = 0; lane < kWidth; ++lane) {
        const std::int32_t triangle = block->triangle[lane];
        const float* at[3] = {nullptr, nullptr, nullptr};
        bool is_valid = triangle >= 0;
        for (std::size_t k = 0; is_valid && k < 3; ++k) {
            at[k] = mesh.xyz + 3 * static_cast<std::size_t>(mesh.tri[3 * static_cast<std::size_t>(triangle) + k]);
            for (int axis = 0; axis < 3; ++axis) is_valid = is_valid && absolute(at[k][axis]) <= kMaxMagnitude;
        }
        for (int k = 0; k < 3; ++k) {
            for (int axis = 0; axis < 3; ++axis) {
                const float value = is_valid ? at[k][axis] : __builtin_nanf("");
                block->corner[k][axis][lane] = value;
                if (value < box.bounds[2 * axis]) box.bounds[2 * axis] = value;
                if (value > box.bounds[2 * axis + 1]) box.bounds[2 * axis + 1] = value;
            }
        }
    }
    return box;
}

Box box_of(const Node& node) {
    Box box = kEmptyBox;
    for (int axis = 0; axis < 3; ++axis) {
        for (int lane = 0; lane < kWidth; ++lane) {
            box.bounds[2 * axis] = std::min(box.bounds[2 * axis], node.bounds[2 * axis][lane]);
            box.bounds[2 * axis + 1] = std::max(box.bounds[2 * axis + 1], node.bounds[2 * axis + 1][lane]);
        }
    }
    return box;
}

// Half of the surface area, or 0 for an empty box.
double area_of(const float (&bounds)[6]) {
    if (!(bounds[0] <= bounds[1])) return 0.0;
    const double x = static_cast<double>(bounds[1]) - bounds[0], y = static_cast<double>(bounds[3]) - bounds[2];
    const double z = static_cast<double>(bounds[5]) - bounds[4];
    return x * y + y * z + z * x;
}

}  // namespace

float refit(const Mesh& mesh, Node* nodes, std::size_t node_count, Block* blocks, std::size_t block_count, int threads) {
    Team team(threads);
    std::vector<Box> block_boxes(block_count), node_boxes(node_count);
    run_parts(team, block_count, kBlocksPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) block_boxes[i] = move_block(mesh, blocks + i);
    });
    // Children have larger indices than their node.
    for (std::size_t i = node_count; i-- > 0;) {
        Node& node = nodes[i];
        for (int lane = 0; lane < kWidth; ++lane) {
            const std::int32_t child = node.child[lane];
            const Box& box = child == kNoChild ? kEmptyBox : child >= 0 ? node_boxes[child] : block_boxes[~child];
            for (int bound = 0; bound < 6; ++bound) node.bounds[bound][lane] = box.bounds[bound];
        }
        node_boxes[i] = box_of(node);
    }
    float magnitude = 0.0f;
    if (node_count == 0) return magnitude;
    for (const float bound : node_boxes[0].bounds) {
        if (absolute(bound) <= kMaxMagnitude) magnitude = std::max(magnitude, absolute(bound));
    }
    return magnitude;
}

double expected_cost(const TreeView& tree) {
    double sum = 0.0, root = 0.0;
    for (std::size_t i = 0; i < tree.node_count; ++i) {
        const Node& node = tree.nodes[i];
        if (i == 0) root = area_of(box_of(node).bounds);
        for (int lane = 0; lane < kWidth; ++lane) {
            float bounds[6];
            for (int bound = 0; bound < 6; ++bound) bounds[bound] = node.bounds[bound][lane];
            sum += area_of(bounds);
        }
    }
    return root > 0.0 ? 1.0 + sum / root : 1.0;
}

}  // namespace fourd::rays
