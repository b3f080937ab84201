#include "binding/module.h"
#include "device/rooms.h"

namespace nb = nanobind;

namespace fourd::cuda {

void bind_module(nb::module_& module) {
    nb::set_leak_warnings(false);  // rooms are kept until the process ends
    nb::class_<device::Rooms>(module, "Rooms", "How much room pictures need, learnt from those before.")
        .def(nb::init<>());
    bind_kernels(module);
}

}  // namespace fourd::cuda
