// The Python module fourd._cuda.
#include "binding/module.h"

NB_MODULE(_cuda, module) {
    module.doc() = "fourd's CUDA kernels (internal; use fourd.rendering and fourd.scene)";
    fourd::cuda::bind_module(module);
}
