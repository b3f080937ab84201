// Builds the tree from the top down. To split a range of primitives in two, the builder sorts their centres into 16
// bins along each axis, and splits the range between the two neighbouring bins where the cost is lowest. The cost
// follows the surface area heuristic (Wald 2007, On fast Construction of SAH-based Bounding Volume Hierarchies). The
// range of a node is split repeatedly, until the node has eight children. The top of the tree is built on one thread,
// and the subtrees below it are built on all threads.
#include "rays/cpu/topology.h"

#include <algorithm>
#include <vector>

namespace fourd::rays {
namespace {

constexpr int kBins = 16;
// At this depth or deeper, nodes split ranges into two halves with equal numbers of primitives, without the surface
// area heuristic, to limit the depth of the tree.
constexpr int kMaxSahDepth = 24;
// The top of the tree is built first, and the subtrees below it are built in parallel. In the top, a range with at most
// 1 / kParts of all primitives is not split further. It is split later, as one of these subtrees.
constexpr std::size_t kParts = 48;
// In the top of the tree, a range of at most kSmallPart primitives also becomes a subtree.
constexpr std::size_t kSmallPart = 4096;
static_assert(kMaxSahDepth + 32 <= kMaxDepth, "2^31 primitives are halved at most 31 times");

// Returns half of the surface area of a box, or 0 if the box is empty.
inline float area_of(const Box& box) {
    const float x = box.high[0] - box.low[0], y = box.high[1] - box.low[1], z = box.high[2] - box.low[2];
    return x >= 0.0f ? x * y + y * z + z * x : 0.0f;
}

inline void extend_by_centre(Box* box, const Reference& reference) {
    for (int i = 0; i < 4; ++i) {
        const float centre = reference.box.low[i] + reference.box.high[i];
        box->low[i] = centre < box->low[i] ? centre : box->low[i];
        box->high[i] = centre > box->high[i] ? centre : box->high[i];
    }
}

struct Range {
    std::size_t begin, end;
    Box box, centres;

    std::size_t size() const { return end - begin; }
};

Range range_of(const Reference* references, std::size_t begin, std::size_t end) {
    Range out{begin, end, kEmptyBox, kEmptyBox};
    for (std::size_t i = begin; i < end; ++i) {
        extend(&out.box, references[i].box);
        extend_by_centre(&out.centres, references[i]);
    }
    return out;
}

struct Bin {
    Box box;
    std::uint32_t count;
};

// Maps the centre of a primitive to a bin along each axis.
struct Binning {
    float low[4], scale[4];

    explicit Binning(const Box& centres) {
        for (int axis = 0; axis < 4; ++axis) {
            const float extent = axis < 3 ? centres.high[axis] - centres.low[axis] : 0.0f;
            low[axis] = centres.low[axis];
            // The factor 0.99999 keeps the largest centre in the last bin, in spite of rounding.
            scale[axis] = extent > 0.0f ? kBins * 0.99999f / extent : 0.0f;
            if (!(scale[axis] <= 3e38f)) scale[axis] = 0.0f;
        }
    }

    int bin_of(const Reference& reference, int axis) const {
        const float centre = reference.box.low[axis] + reference.box.high[axis];
        return std::min(kBins - 1, static_cast<int>((centre - low[axis]) * scale[axis]));
    }
};

// A plane that splits a range: primitives in bins below `bin` lie on one side. If no plane separates the primitives,
// `axis` is -1.
struct Plane {
    int axis, bin;
};

// Returns the cost of a box by the surface area heuristic: the number of blocks for `count` primitives, times half of
// the surface area.
inline float cost_of(const Box& box, std::size_t count) {
    return area_of(box) * static_cast<float>((count + kWidth - 1) / kWidth);
}

Plane best_plane(const Reference* references, const Range& range, const Binning& binning) {
    Bin bins[3][kBins];
    for (auto& axis : bins) std::fill_n(axis, kBins, Bin{kEmptyBox, 0});
    for (std::size_t i = range.begin; i < range.end; ++i) {
        for (int axis = 0; axis < 3; ++axis) {
            Bin& bin = bins[axis][binning.bin_of(references[i], axis)];
            extend(&bin.box, references[i].box);
            ++bin.count;
        }
    }
    Plane best{-1, 0};
    float least = kInfinity;
    for (int axis = 0; axis < 3; ++axis) {
        if (binning.scale[axis] == 0.0f) continue;
        float cost_above[kBins];
        Box box = kEmptyBox;
        std::size_t count = 0;
        for (int bin = kBins - 1; bin > 0; --bin) {
            extend(&box, bins[axis][bin].box);
            count += bins[axis][bin].count;
            cost_above[bin] = cost_of(box, count);
        }
        box = kEmptyBox;
        count = 0;
        for (int bin = 1; bin < kBins; ++bin) {
            extend(&box, bins[axis][bin - 1].box);
            count += bins[axis][bin - 1].count;
            const float cost = cost_of(box, count) + cost_above[bin];
            if (count > 0 && count < range.size() && cost < least) {
                least = cost;
                best = {axis, bin};
            }
        }
    }
    return best;
}

// Splits a range into two ranges with at least one primitive each.
void split(Reference* references, const Range& range, bool in_halves, Range* left, Range* right) {
    const Binning binning(range.centres);
    const Plane plane = in_halves ? Plane{-1, 0} : best_plane(references, range, binning);
    if (plane.axis < 0) {
        const std::size_t middle = range.begin + range.size() / 2;
        *left = range_of(references, range.begin, middle);
        *right = range_of(references, middle, range.end);
        return;
    }
    *left = {range.begin, 0, kEmptyBox, kEmptyBox};
    *right = {0, range.end, kEmptyBox, kEmptyBox};
    std::size_t at = range.begin, end = range.end;
    while (at < end) {
        const bool is_left = binning.bin_of(references[at], plane.axis) < plane.bin;
        Range* const to = is_left ? left : right;
        extend(&to->box, references[at].box);
        extend_by_centre(&to->centres, references[at]);
        if (is_left) {
            ++at;
        } else {
            std::swap(references[at], references[--end]);
        }
    }
    left->end = right->begin = at;
}

// Splits a range into up to eight ranges. Each step splits one range into two: the range whose box has the largest
// area. Ranges of up to kWidth primitives are not split.
std::vector<Range> children_of(Reference* references, const Range& range, bool in_halves) {
    std::vector<Range> out{range};
    while (out.size() < kWidth) {
        std::size_t largest = out.size();
        float area = -1.0f;
        for (std::size_t i = 0; i < out.size(); ++i) {
            if (out[i].size() > kWidth && area_of(out[i].box) > area) area = area_of(out[i].box), largest = i;
        }
        if (largest == out.size()) break;
        Range left, right;
        split(references, out[largest], in_halves, &left, &right);
        out[largest] = left;
        out.push_back(right);
    }
    return out;
}

// A part of the tree. The child indices are indices within the part.
struct Part {
    std::vector<Node> nodes;
    std::vector<Leaf> leaves;
};

std::int32_t add_leaf(const Reference* references, const Range& range, Part* part) {
    Leaf leaf;
    std::fill_n(leaf.index, kWidth, -1);
    for (std::size_t i = range.begin; i < range.end; ++i) leaf.index[i - range.begin] = references[i].index;
    part->leaves.push_back(leaf);
    return ~static_cast<std::int32_t>(part->leaves.size() - 1);
}

std::int32_t add_node(Part* part) {
    Node node;
    std::fill_n(node.child, kWidth, kNoChild);
    std::fill_n(node.unused, kWidth, 0);
    part->nodes.push_back(node);
    return static_cast<std::int32_t>(part->nodes.size() - 1);
}

std::int32_t build_subtree(Reference* references, const Range& range, int depth, Part* part) {
    if (range.size() <= kWidth) return add_leaf(references, range, part);
    const std::int32_t index = add_node(part);
    const std::vector<Range> ranges = children_of(references, range, depth >= kMaxSahDepth);
    for (std::size_t k = 0; k < ranges.size(); ++k) {
        const std::int32_t child = build_subtree(references, ranges[k], depth + 1, part);
        part->nodes[index].child[k] = child;
    }
    return index;
}

// A task builds the subtree of a range. The parent of this subtree is the node with the index `node` in the top of the
// tree, and the subtree becomes child `lane` of this parent.
struct Task {
    Range range;
    std::int32_t node;
    int lane, depth;
    Part part;
    std::int32_t root;
};

void build_top(Reference* references, const Range& range, int depth, std::size_t largest_part, Part* top,
               std::int32_t index, std::vector<Task>* tasks) {
    const std::vector<Range> ranges = children_of(references, range, depth >= kMaxSahDepth);
    for (std::size_t k = 0; k < ranges.size(); ++k) {
        if (ranges[k].size() <= largest_part || depth >= kMaxSahDepth) {
            tasks->push_back({ranges[k], index, static_cast<int>(k), depth + 1, {}, 0});
        } else {
            const std::int32_t child = add_node(top);
            top->nodes[index].child[k] = child;
            build_top(references, ranges[k], depth + 1, largest_part, top, child, tasks);
        }
    }
}

std::int32_t moved(std::int32_t child, std::size_t nodes, std::size_t leaves) {
    if (child == kNoChild) return child;
    return child >= 0 ? child + static_cast<std::int32_t>(nodes) : ~(~child + static_cast<std::int32_t>(leaves));
}

// Joins the top of the tree and the subtrees.
Topology join(const Part& top, std::vector<Task>& tasks, Team& team) {
    std::vector<std::size_t> first_node, first_leaf;
    std::size_t nodes = top.nodes.size(), leaves = 0;
    for (const Task& task : tasks) {
        first_node.push_back(nodes);
        first_leaf.push_back(leaves);
        nodes += task.part.nodes.size();
        leaves += task.part.leaves.size();
    }
    Topology out{Buffer<Node>(nodes), Buffer<Leaf>(leaves)};
    std::copy(top.nodes.begin(), top.nodes.end(), out.nodes.data());
    team.run(static_cast<int>(tasks.size()), [&](int index, int) {
        const Task& task = tasks[index];
        std::copy(task.part.leaves.begin(), task.part.leaves.end(), out.leaves.data() + first_leaf[index]);
        Node* to = out.nodes.data() + first_node[index];
        for (const Node& node : task.part.nodes) {
            *to = node;
            for (std::int32_t& child : to->child) child = moved(child, first_node[index], first_leaf[index]);
            ++to;
        }
        out.nodes[task.node].child[task.lane] = moved(task.root, first_node[index], first_leaf[index]);
    });
    return out;
}

}  // namespace

Topology build_topology(Reference* references, std::size_t count, Team& team) {
    if (count == 0) return {};
    Part top;
    std::vector<Task> tasks;
    add_node(&top);
    build_top(references, range_of(references, 0, count), 0, std::max(kSmallPart, count / kParts), &top, 0, &tasks);
    team.run(static_cast<int>(tasks.size()), [&](int index, int) {
        Task& task = tasks[index];
        task.root = build_subtree(references, task.range, task.depth, &task.part);
    });
    return join(top, tasks, team);
}

}  // namespace fourd::rays
