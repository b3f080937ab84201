// Selects where kernels run. If nvcc compiles this file, kernels run on a GPU. Otherwise, they are emulated on the CPU,
// for tests.
#pragma once

#ifdef __CUDACC__
#include "device/cuda.h"
#else
#include "device/emulated.h"
#endif
