// The inner loops over triangles and tiles, compiled once for each instruction set.
#include <cstring>
#if defined(__SSE2__) || defined(__AVX512F__)
#include <immintrin.h>
#endif

#include "common/inline.h"
#include "splat_triangles/cpu/tiles.h"

namespace fourd::splat_triangles::FOURD_SIMD {
namespace {

#include "tiles/lanes.h"
#include "tiles/powers.inc"
#include "tiles/gather.inc"
#include "tiles/grid.inc"
#include "splat_triangles/cpu/projection.inc"
#include "splat_triangles/cpu/coverage.inc"
#include "tiles/traversal.inc"
#include "tiles/pixels.inc"
#include "splat_triangles/cpu/picture.inc"
#include "splat_triangles/cpu/gradient.inc"

}  // namespace

const Loops loops = {project_run, render_tile, render_tile_backward};

}  // namespace fourd::splat_triangles::FOURD_SIMD
