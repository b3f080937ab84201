#define FOURD_SIMD avx512
#include "points/cpu/tile_kernels.inc"
