// The Python module of the example kernel. csrc/binding/module.cpp is the Python module of the package.
#include "binding/module.h"

NB_MODULE(_example, module) { fourd::bind_kernels(module); }
