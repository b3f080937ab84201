// Builds the structure of a bounding volume hierarchy (rays/rays.h). The primitives may be of any kind, because only
// their bounding boxes are used.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/team.h"
#include "rays/maths.h"
#include "rays/rays.h"

namespace fourd::rays {

// The fourth coordinate is unused, but arrays of four coordinates let compilers use vector instructions.
struct Box {
    float low[4], high[4];
};

constexpr Box kEmptyBox = {{kInfinity, kInfinity, kInfinity, kInfinity},
                           {-kInfinity, -kInfinity, -kInfinity, -kInfinity}};

inline void extend(Box* box, const Box& by) {
    for (int i = 0; i < 4; ++i) {
        box->low[i] = by.low[i] < box->low[i] ? by.low[i] : box->low[i];
        box->high[i] = by.high[i] > box->high[i] ? by.high[i] : box->high[i];
    }
}

// The box and the index of a primitive. build_topology() reorders the references, so that each leaf has a contiguous
// range of them.
struct alignas(16) Reference {
    Box box;
    std::int32_t index;
};

// The indices of up to kWidth primitives. Unused elements are -1.
struct Leaf {
    std::int32_t index[kWidth];
};

struct Topology {
    Buffer<Node> nodes;  // Node::bounds is not set. A negative child c is the leaf with the index ~c.
    Buffer<Leaf> leaves;
};

// Builds the structure of a tree, and sorts the references. The result is the same for any number of threads.
Topology build_topology(Reference* references, std::size_t count, Team& team);

// The bounding box of the primitives in a leaf, in the order of Node::bounds.
struct LeafBox {
    float bounds[6];
};

constexpr LeafBox kEmptyLeafBox = {{kInfinity, -kInfinity, kInfinity, -kInfinity, kInfinity, -kInfinity}};

// Computes the bounds of all nodes from the bounds of the leaves. Returns the largest absolute coordinate of the
// bounding box of the whole tree. Coordinates above kMaxMagnitude, such as those of an empty box, are ignored.
float fill_bounds(Node* nodes, std::size_t node_count, const LeafBox* leaves);

}  // namespace fourd::rays
