// The Python module fourd._emulated: the CUDA kernels compiled for the CPU, for tests.
#include "binding/module.h"

NB_MODULE(_emulated, module) {
    module.doc() = "fourd's CUDA kernels compiled for the CPU, for tests";
    fourd::cuda::bind_module(module);
}
