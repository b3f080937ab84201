#define FOURD_SIMD avx2
#include "points/cpu/tile_kernels.inc"
