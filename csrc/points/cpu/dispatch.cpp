#include "points/cpu/tiles.h"

namespace fourd::points {

const TileKernels& tile_kernels(Simd simd) {
#ifdef FOURD_X86
    if (simd == Simd::avx512) return tile_kernels_avx512;
    if (simd == Simd::avx2) return tile_kernels_avx2;
#endif
    (void)simd;
    return tile_kernels_baseline;
}

}  // namespace fourd::points
