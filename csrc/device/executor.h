// Selects where kernels run. They run on a GPU if nvcc compiles this file. Otherwise they are emulated on the CPU, for
// tests.
#pragma once

#ifdef __CUDACC__
#include "device/cuda.h"
#else
#include "device/emulated.h"
#endif
