// The functions that bind all kernels; cmake/kernel.cmake generates those that call each kernel's own.
#pragma once

#include <nanobind/nanobind.h>

namespace fourd {

void bind_kernels(nanobind::module_& module);

namespace cuda {

void bind_kernels(nanobind::module_& module);

// Binds the kernels and the types that they share.
void bind_module(nanobind::module_& module);

}  // namespace cuda
}  // namespace fourd
