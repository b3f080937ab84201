// The Python face of csrc: this file converts and validates, the kernels know no framework.
#include <nanobind/nanobind.h>
#include <omp.h>

namespace nb = nanobind;

NB_MODULE(_native, module) {
    module.doc() = "fourd's native kernels (internal; use fourd.raster and fourd.baking)";
    module.def("max_threads", [] { return omp_get_max_threads(); },
               "Number of threads that kernels use when the caller names none.");
}
