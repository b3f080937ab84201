// The Python module fourd._emulated has the CUDA kernels, compiled for the CPU. Only tests use this module.
#include "binding/module.h"

NB_MODULE(_emulated, module) {
    module.doc() = "fourd's CUDA kernels compiled for the CPU, for tests";
    fourd::cuda::bind_module(module);
}
