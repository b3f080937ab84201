// Compositing of discs along rays, compiled once for each instruction set.
#pragma once

#include "common/dispatch.h"
#include "rays/discs.h"

namespace fourd::rays::discs {

struct Loops {
    void (*composite)(const DiscTreeView& tree, const Rays& rays, const DiscPicture& picture, std::size_t begin,
                      std::size_t end);
};

FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::rays::discs
