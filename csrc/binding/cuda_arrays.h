// Types that the bindings of CUDA kernels share. These types are compiled for real GPUs, and also for the emulated GPU,
// which runs on the CPU.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>

namespace fourd::cuda {

#ifdef FOURD_EMULATED
using Where = nanobind::device::cpu;
#else
using Where = nanobind::device::cuda;
#endif

template <typename Number, typename Shape>
using Array = nanobind::ndarray<Number, Shape, nanobind::c_contig, Where>;

using Workspace = Array<std::uint8_t, nanobind::ndim<1>>;

inline void* stream_of(std::uintptr_t handle) { return reinterpret_cast<void*>(handle); }

}  // namespace fourd::cuda
