// Ray tracing of triangle meshes. Callers check shapes. Every pointer points to a dense row-major array.
//
// The tree is a bounding volume hierarchy (BVH). Its nodes have up to eight children, and its leaves, called blocks,
// have up to eight triangles. The index of a child node is larger than the index of its parent. A traversal skips only
// triangles that the ray does not hit, so it finds the same hits as a loop that tests every triangle with intersect()
// in maths.h.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/buffer.h"
#include "common/host_device.h"
#include "common/inline.h"
#include "common/simd.h"

namespace fourd::rays {

constexpr int kWidth = 8;                       // Maximum number of children of a node, and of triangles of a block.
constexpr std::int32_t kNoChild = -2147483647;  // Marks a missing child. Every other child c < 0 is the block ~c.
constexpr int kMaxDepth = 56;                   // Maximum depth of a tree.
constexpr int kMaxStack = kWidth * kMaxDepth;   // Maximum number of entries on the stack of a traversal.

struct alignas(64) Node {
    float bounds[6][kWidth];  // Smallest x, largest x, smallest y, largest y, smallest z, largest z of each child.
    std::int32_t child[kWidth];  // Index of the child node, ~index of the child block, or kNoChild.
    std::int32_t unused[kWidth];
};

struct alignas(64) Block {
    // Coordinates of the corners, indexed by corner, axis and position in the block. The coordinates of a triangle that
    // cannot be hit are NaN.
    float corner[3][3][kWidth];
    std::int32_t triangle[kWidth];  // Indices of the triangles in the mesh. Unused elements are -1.
};

struct Mesh {
    const float* xyz;  // Shape (vertices, 3).
    std::size_t vertices;
    const std::int32_t* tri;  // Shape (triangles, 3). A triangle with a vertex index out of range is never hit.
    std::size_t triangles;

    // Writes the three vertex indices of a triangle to `corners`. Returns false if `triangle` or one of the vertex
    // indices is out of range.
    FOURD_HD FOURD_INLINE bool find(std::int32_t triangle, std::size_t* corners) const {
        if (triangle < 0 || static_cast<std::size_t>(triangle) >= triangles) return false;
        for (std::size_t k = 0; k < 3; ++k) {
            corners[k] = static_cast<std::uint32_t>(tri[3 * static_cast<std::size_t>(triangle) + k]);
            if (corners[k] >= vertices) return false;
        }
        return true;
    }
};

struct Tree {
    Buffer<Node> nodes;
    Buffer<Block> blocks;
    float magnitude = 0.0f;  // The largest absolute coordinate of all triangles that can be hit.
};

struct TreeView {
    const Node* nodes;
    std::size_t node_count;
    const Block* blocks;
    std::size_t block_count;
    float magnitude;
};

// Builds the tree with the surface area heuristic. The tree is the same for any number of threads. A triangle is never
// hit if one of its coordinates is NaN, or has an absolute value above kMaxMagnitude.
Tree build(const Mesh& mesh, int threads);

// Updates a tree after the vertices of its triangles have moved. `mesh` must have the triangles for which the tree was
// built. Returns the new value of Tree::magnitude.
float refit(const Mesh& mesh, Node* nodes, std::size_t node_count, Block* blocks, std::size_t block_count, int threads);

// Returns the expected number of nodes and blocks that a random ray visits if it hits the box of the root.
double expected_cost(const TreeView& tree);

struct Rays {
    const float* origins;     // Shape (count, 3).
    const float* directions;  // Shape (count, 3), of any length. The point at t is origin + t * direction.
    std::size_t count;
    const float* t_min;  // Shape (count,), or one number if t_min_stride is 0.
    std::size_t t_min_stride;
    const float* t_max;  // Shape (count,), or one number if t_max_stride is 0.
    std::size_t t_max_stride;
    // Shape (count,) each, or null: the last hit to skip. All hits up to and including this one, in the order of (t,
    // triangle), are skipped.
    const float* after_t;
    const std::int32_t* after_triangle;
    int threads;
    Simd simd;
};

// The `layers` nearest hits of each ray in the order of (t, triangle).
struct Hits {
    int layers;
    float* t;                // Shape (count, layers): infinite where there is no hit.
    float* u;                // Shape (count, layers): barycentric weight of vertex 0; 0 where there is no hit.
    float* v;                // Shape (count, layers): barycentric weight of vertex 1; 0 where there is no hit.
    std::int32_t* triangle;  // Shape (count, layers): index of the triangle, or -1 where there is no hit.
};

void trace(const TreeView& tree, const Rays& rays, const Hits& hits);

// Writes 1 for each ray that has a hit with t in [t_min, t_max], and 0 for all other rays.
void occluded(const TreeView& tree, const Rays& rays, std::uint8_t* out);

// The arguments of trace_backward(), for `count` rays with `layers` hits each. The arrays from `origins` to
// `triangle` have the shapes in Rays and Hits.
struct HitGradients {
    const float* origins;
    const float* directions;
    std::size_t count;
    int layers;
    const float *t, *u, *v;
    const std::int32_t* triangle;
    const float *to_t, *to_u, *to_v;     // Gradients with respect to t, u and v, of shape (count, layers).
    // Outputs: the gradients with respect to Mesh::xyz, `origins` and `directions`, in the shapes of these arrays.
    float *xyz, *to_origins, *to_directions;
    int threads;
};

// Gradients are summed in a fixed order, so the result is the same for any number of threads.
void trace_backward(const Mesh& mesh, const HitGradients& gradients);

}  // namespace fourd::rays
