// The functions that bind all kernels. cmake/kernel.cmake generates bind_kernels, which calls the binding function of
// each kernel.
#pragma once

#include <nanobind/nanobind.h>

namespace fourd {

void bind_kernels(nanobind::module_& module);

namespace cuda {

void bind_kernels(nanobind::module_& module);

// Binds all CUDA kernels and the types that these kernels share.
void bind_module(nanobind::module_& module);

}  // namespace cuda
}  // namespace fourd
