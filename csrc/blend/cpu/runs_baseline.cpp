#define FOURD_SIMD baseline
#include "blend/cpu/runs.inc"
