// Where GPU kernels run: on a GPU if nvcc compiles this, else emulated, to be tested without one.
#pragma once

#ifdef __CUDACC__
#include "device/cuda.h"
#else
#include "device/emulated.h"
#endif
