// Marks maths that compiles for the CPU and, under nvcc, for the GPU.
#pragma once

#ifdef __CUDACC__
#define FOURD_HD __host__ __device__
#else
#define FOURD_HD
#endif
