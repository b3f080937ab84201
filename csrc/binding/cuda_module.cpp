// The Python module fourd._cuda.
#include "binding/module.h"

NB_MODULE(_cuda, module) {
    module.doc() = "fourd's CUDA kernels (internal; use fourd.raster and fourd.baking)";
    fourd::cuda::bind_module(module);
}
