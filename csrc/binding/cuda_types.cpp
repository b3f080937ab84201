#include "binding/module.h"
#include "device/entry_estimator.h"

namespace nb = nanobind;

namespace fourd::cuda {

void bind_module(nb::module_& module) {
    // Without this call, nanobind would report the entry estimators as leaks, because they stay allocated until the
    // process ends.
    nb::set_leak_warnings(false);
    nb::class_<device::EntryEstimator>(module, "EntryEstimator",
                                       "Predicts the number of entries of an image from earlier images.")
        .def(nb::init<>());
    bind_kernels(module);
}

}  // namespace fourd::cuda
