// The traversal of the bounding volume hierarchy (rays/rays.h), compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "rays/rays.h"

namespace fourd::rays {

struct Loops {
    // Traces the rays [begin, end).
    void (*trace)(const TreeView& tree, const Rays& rays, std::size_t begin, std::size_t end, const Hits& hits);
    void (*occluded)(const TreeView& tree, const Rays& rays, std::size_t begin, std::size_t end, std::uint8_t* out);
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::rays
