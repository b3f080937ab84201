#include <algorithm>
#include <vector>

#include "rays/cpu/topology.h"
#include "rays/maths.h"

namespace fourd::rays {
namespace {

LeafBox box_of(const Node& node) {
    LeafBox box = kEmptyLeafBox;
    for (int axis = 0; axis < 3; ++axis) {
        for (int lane = 0; lane < kWidth; ++lane) {
            box.bounds[2 * axis] = std::min(box.bounds[2 * axis], node.bounds[2 * axis][lane]);
            box.bounds[2 * axis + 1] = std::max(box.bounds[2 * axis + 1], node.bounds[2 * axis + 1][lane]);
        }
    }
    return box;
}

// Returns half of the surface area of a box, or 0 if the box is empty.
double area_of(const float (&bounds)[6]) {
    if (!(bounds[0] <= bounds[1])) return 0.0;
    const double x = static_cast<double>(bounds[1]) - bounds[0], y = static_cast<double>(bounds[3]) - bounds[2];
    const double z = static_cast<double>(bounds[5]) - bounds[4];
    return x * y + y * z + z * x;
}

}  // namespace

float fill_bounds(Node* nodes, std::size_t node_count, const LeafBox* leaves) {
    std::vector<LeafBox> boxes(node_count);
    // Because child indices are larger than the index of their parent, the loop runs from the last node to the first,
    // so that the bounds of children are computed before those of their parent.
    for (std::size_t i = node_count; i-- > 0;) {
        Node& node = nodes[i];
        for (int lane = 0; lane < kWidth; ++lane) {
            const std::int32_t child = node.child[lane];
            const LeafBox& box = child == kNoChild ? kEmptyLeafBox : child >= 0 ? boxes[child] : leaves[~child];
            for (int bound = 0; bound < 6; ++bound) node.bounds[bound][lane] = box.bounds[bound];
        }
        boxes[i] = box_of(node);
    }
    float magnitude = 0.0f;
    if (node_count == 0) return magnitude;
    for (const float bound : boxes[0].bounds) {
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
