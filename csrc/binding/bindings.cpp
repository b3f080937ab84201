// The Python face of csrc: bindings convert and check shapes, the kernels know no framework.
#include "binding/bindings.h"

#include <algorithm>
#include <thread>

NB_MODULE(_native, module) {
    module.doc() = "fourd's native kernels (internal; use fourd.raster and fourd.baking)";
    module.def("max_threads", [] { return std::max(1u, std::thread::hardware_concurrency()); },
               "Number of threads that kernels use when the caller names none.");
    fourd::bind_points(module);
    fourd::bind_shade(module);
}
