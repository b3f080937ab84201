// The binding functions of all kernels; CMake generates the two that call every kernel's own (cmake/kernel.cmake).
#pragma once

#include <nanobind/nanobind.h>

namespace fourd {

void bind_kernels(nanobind::module_& module);

namespace cuda {

void bind_kernels(nanobind::module_& module);

// The kernels and the types that they share.
void bind_module(nanobind::module_& module);

}  // namespace cuda
}  // namespace fourd
