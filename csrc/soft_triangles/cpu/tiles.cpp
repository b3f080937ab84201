// The inner loops over triangles and tiles, compiled once for each instruction set.
#include <cstring>
#if defined(__SSE2__) || defined(__AVX512F__)
#include <immintrin.h>
#endif

#include "common/inline.h"
#include "soft_triangles/cpu/tiles.h"

namespace fourd::soft_triangles::FOURD_SIMD {
namespace {

#include "tiles/lanes.h"
#include "tiles/powers.inc"
#include "tiles/gather.inc"
#include "tiles/grid.inc"
#include "tiles/pixels.inc"
#include "soft_triangles/cpu/projection.inc"
#include "soft_triangles/cpu/visits.inc"
#include "soft_triangles/cpu/picture.inc"

}  // namespace

const Loops loops = {project_run, render_tile, render_tile_backward};

}  // namespace fourd::soft_triangles::FOURD_SIMD
