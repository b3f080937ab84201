#define FOURD_SIMD baseline
#include "points/cpu/tile_kernels.inc"
