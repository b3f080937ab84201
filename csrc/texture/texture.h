// Filtered texture lookup with mip levels. Callers check shapes. Every pointer points to a dense row-major array.
// fourd/rendering/triangles/textures.py documents the operations.
#pragma once

#include <cstddef>

#include "common/simd.h"
#include "texture/cube.h"

namespace fourd::texture {

constexpr int kMaxLevels = 16;
constexpr int kMaxSide = 1 << (kMaxLevels - 1);

FOURD_HD FOURD_INLINE int side_at(int side, int level) { return side >> level > 1 ? side >> level : 1; }

// The sizes of a texture and its mip levels. Each level has half the size of the previous level, rounded down, but at
// least one texel.
struct Shape {
    std::size_t items;          // Number of textures.
    int faces, height, width;   // Size of level 0. A cube map has 6 faces, and every other texture has one.
    int channels;
    int level_count;            // From 1 to kMaxLevels.

    // Returns the number of texels of one item (texture) in mip level `level`. The number is below 2^31.
    FOURD_HD FOURD_INLINE std::size_t texels(int level) const {
        return static_cast<std::size_t>(faces) * side_at(height, level) * side_at(width, level);
    }
    // Returns the number of floats of one item in mip level `level`.
    FOURD_HD FOURD_INLINE std::size_t floats(int level) const { return texels(level) * channels; }
};

struct Texture {
    Shape shape;
    const float* levels[kMaxLevels];  // Each level has the shape (items, faces, height, width, channels).

    FOURD_HD FOURD_INLINE const float* item(int level, std::size_t picture) const {
        return levels[level] + (shape.items == 1 ? 0 : picture) * shape.floats(level);
    }
};

struct Query {
    Texture texture;  // The texture has one item for each picture, or one item that all pictures share.
    Filter filter;
    Boundary boundary;
    const float* uv;      // Shape (pictures, pixels, 2), or (pictures, pixels, 3) for a cube.
    const float* uv_da;   // Shape (pictures, pixels, 4), or (pictures, pixels, 6) for a cube, or null.
    const float* bias;    // Shape (pictures, pixels), added to the mip level, or null. Only filters with mip levels
                          // read uv_da and bias.
    std::size_t pictures, pixels;
    int threads;  // At least 1. Only the CPU uses threads, and the result does not depend on their number.
    Simd simd;    // An instruction set that this machine supports. Only the CPU uses simd.

    FOURD_HD FOURD_INLINE int coordinates() const { return boundary == Boundary::cube ? 3 : 2; }
};

// Gradients with respect to the inputs. Each gradient has the shape of its input. A gradient whose pointer is null is
// not computed.
struct Gradients {
    float* levels[kMaxLevels];  // Either all pointers are null, or none is null.
    float* uv;
    float* uv_da;
    float* bias;
};

// Writes the sampled pictures to `out` (pictures, pixels, channels).
void sample(const Query& query, float* out);

// Computes the gradients of sample(). `gradient` is the gradient of the loss with respect to the `out` of sample(). If
// is_chain is true, levels 1 and up were computed from level 0 by build_mips(), so their gradients are propagated back
// to level 0.
void sample_backward(const Query& query, const float* gradient, bool is_chain, const Gradients& out);

// Computes levels 1 and up from level 0. A texel is the mean of 2 x 2 texels of the previous level, or of 2 texels if
// the previous level has only one row or one column. mips[k] is level k + 1.
void build_mips(const Shape& shape, const float* base, float* const* mips, int threads, Simd simd);

}  // namespace fourd::texture
