// The Python module fourd._native. Bindings check and convert arguments; the kernels know no framework.
#include "binding/module.h"

#include <nanobind/stl/string.h>

#include <algorithm>
#include <string>
#include <thread>

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
               "Number of threads that kernels use by default.");
    module.def("simd_default", &fourd::simd_default, "The widest instruction set that this machine runs.");
    module.def(
        "simd_available",
        [](const std::string& name) { return name == "emulated" ? kEmulated : fourd::simd_available(name.c_str()); },
        nanobind::arg("name"), "Whether this machine and build run an instruction set, or the emulated CUDA kernels.");
#ifdef FOURD_EMULATED
    nanobind::module_ emulated = module.def_submodule("emulated", "The CUDA kernels compiled for the CPU, for tests.");
    fourd::cuda::bind_module(emulated);
#endif
    fourd::bind_kernels(module);
}
