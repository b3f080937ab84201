// The Python module fourd._native. Bindings check and convert arguments. The kernels do not depend on Python or torch.
#include "binding/module.h"

#include <nanobind/stl/string.h>

#include <algorithm>
#include <string>
#include <thread>

#include "common/simd.h"

NB_MODULE(_native, module) {
    module.doc() = "fourd's native kernels (internal; use fourd.rendering and fourd.scene)";
    module.def(
        "max_threads", [] { return std::max(1u, std::thread::hardware_concurrency()); },
        "Number of threads that kernels use by default.");
    module.def("simd_default", &fourd::simd_default, "The widest instruction set that this machine runs.");
    module.def(
        "simd_available", [](const std::string& name) { return fourd::simd_available(name.c_str()); },
        nanobind::arg("name"), "Whether this machine runs an instruction set: baseline, avx2 or avx512.");
    fourd::bind_kernels(module);
}
