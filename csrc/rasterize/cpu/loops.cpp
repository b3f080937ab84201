// The inner loops over tiles, compiled once for each instruction set.
#include "rasterize/cpu/loops.h"

#include <cstring>

#include "common/inline.h"
#include "rasterize/gradient.h"

namespace fourd::rasterize::FOURD_SIMD {
namespace {

#include "rasterize/cpu/records.inc"
#include "rasterize/cpu/cover.inc"
#include "rasterize/cpu/shade.inc"
#include "rasterize/cpu/gradient.inc"

void rasterize_tile(const Tile& tile) {
    if (tile.count == 0) return clear_tile(tile);
    TileBuffer buffer;
    if (tile.previous == nullptr) {
        cover_tile<false>(tile, buffer);
    } else {
        load_previous(tile, buffer);
        cover_tile<true>(tile, buffer);
    }
    shade_tile(tile, buffer);
}

}  // namespace

const Loops loops = {rasterize_tile, gradient_tile};

}  // namespace fourd::rasterize::FOURD_SIMD
