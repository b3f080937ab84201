#include "binding/cuda/arrays.h"
#include "device/rooms.h"

namespace nb = nanobind;

namespace fourd::cuda {

void bind(nb::module_& module) {
    nb::set_leak_warnings(false);  // rooms are kept until the process ends
    nb::class_<device::Rooms>(module, "Rooms", "How much room pictures need, learnt from those before.")
        .def(nb::init<>());
    bind_hashgrid(module);
    bind_planes(module);
    bind_play(module);
    bind_points(module);
    bind_sources(module);
}

}  // namespace fourd::cuda
