// Macros for functions that compile for the CPU and, with nvcc, also for the GPU.
#pragma once

#ifdef __CUDACC__
#define FOURD_HD __host__ __device__  // Marks functions that the CPU and the GPU share.
#define FOURD_DEVICE __device__       // Marks functions that run on the GPU, or are emulated on the CPU.
#else
#define FOURD_HD
#define FOURD_DEVICE
#endif
