#define FOURD_SIMD avx512
#include "blend/cpu/runs.inc"
