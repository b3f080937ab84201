// The Python face of the CUDA kernels.
#include "binding/cuda/arrays.h"

NB_MODULE(_cuda, module) {
    module.doc() = "fourd's CUDA kernels (internal; use fourd.raster and fourd.baking)";
    fourd::cuda::bind(module);
}
