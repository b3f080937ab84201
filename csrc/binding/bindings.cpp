// The Python face of csrc: bindings convert and check shapes, the kernels know no framework.
#include "binding/bindings.h"

#include <nanobind/stl/string.h>

#include <algorithm>
#include <string>
#include <thread>

#include "binding/cuda/arrays.h"
#include "common/simd.h"

namespace {

#ifdef FOURD_EMULATED
constexpr bool kEmulated = true;
#else
constexpr bool kEmulated = false;
#endif

}  // namespace

NB_MODULE(_native, module) {
    module.doc() = "fourd's native kernels (internal; use fourd.raster and fourd.baking)";
    module.def("max_threads", [] { return std::max(1u, std::thread::hardware_concurrency()); },
               "Number of threads that kernels use when the caller names none.");
    module.def("simd_default", &fourd::simd_default, "The widest instruction set this machine runs.");
    module.def("simd_available", [](const std::string& name) {
        return name == "emulated" ? kEmulated : fourd::simd_available(name.c_str());
    });
#ifdef FOURD_EMULATED
    nanobind::module_ emulated = module.def_submodule("emulated", "The CUDA kernels' source run on the CPU, for tests.");
    fourd::cuda::bind(emulated);
#endif
    fourd::bind_blend(module);
    fourd::bind_hashgrid(module);
    fourd::bind_planes(module);
    fourd::bind_play(module);
    fourd::bind_points(module);
    fourd::bind_shade(module);
    fourd::bind_similarity(module);
    fourd::bind_sources(module);
}
