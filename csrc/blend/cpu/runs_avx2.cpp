#define FOURD_SIMD avx2
#include "blend/cpu/runs.inc"
