// The module of the example; csrc/binding/module.cpp is that of the package.
#include "binding/module.h"

NB_MODULE(_example, module) { fourd::bind_kernels(module); }
