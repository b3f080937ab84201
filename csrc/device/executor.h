// Selects where kernels run: on a GPU if nvcc compiles this, else emulated on the CPU, for tests.
#pragma once

#ifdef __CUDACC__
#include "device/cuda.h"
#else
#include "device/emulated.h"
#endif
