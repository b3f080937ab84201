#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <string>

#include "binding/require.h"
#include "saxpy/saxpy.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Values = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using ValuesOut = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void run(float a, const Values& x, const Values& y, const std::string& simd, const ValuesOut& out) {
    require(y.shape(0) == x.shape(0) && out.shape(0) == x.shape(0), "y, out: expected as many values as x");
    const saxpy::Loops& loops = saxpy::select_loops(simd_named(simd.c_str()));
    nb::gil_scoped_release release;
    loops.saxpy(a, x.data(), y.data(), x.shape(0), out.data());
}

}  // namespace

void bind_saxpy(nb::module_& module) {
    module.def("saxpy", &run, nb::arg("a"), nb::arg("x"), nb::arg("y"), nb::arg("simd"), nb::arg("out"),
               "Sizes: x=N y=N out=N");
}

}  // namespace fourd
