// Python bindings of structural similarity; fourd/rendering/ops/similarity/op.py documents the operations.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <optional>
#include <string>

#include "binding/require.h"
#include "similarity/similarity.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Picture = nb::ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using PictureOut = nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

constexpr std::size_t kLongestSide = 1 << 18;

template <typename One>
bool like(const One& one, const Picture& other) {
    return one.shape(0) == other.shape(0) && one.shape(1) == other.shape(1) && one.shape(2) == other.shape(2);
}

double similarity_of(const Picture& picture, const Picture& truth, int threads, const std::string& simd,
                     const std::optional<PictureOut>& out_gradient) {
    const std::size_t height = picture.shape(0), width = picture.shape(1), channels = picture.shape(2);
    require(height >= similarity::kWindow && width >= similarity::kWindow && height <= kLongestSide &&
                width <= kLongestSide && channels >= 1 && channels <= 64,
            "picture: expected sides from 11 to 2^18 pixels and 1 to 64 channels");
    require(like(truth, picture), "truth: expected the picture's shape");
    require(!out_gradient || like(*out_gradient, picture), "out_gradient: expected the picture's shape");
    const similarity::Pictures pictures{picture.data(),
                                        truth.data(),
                                        static_cast<int>(width),
                                        static_cast<int>(height),
                                        static_cast<int>(channels),
                                        clamp_threads(threads),
                                        simd_named(simd.c_str())};
    float* const gradient = out_gradient ? out_gradient->data() : nullptr;
    nb::gil_scoped_release release;
    return similarity::similarity(pictures, gradient);
}

}  // namespace

void bind_similarity(nb::module_& module) {
    module.def("similarity", &similarity_of, nb::arg("picture"), nb::arg("truth"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("out_gradient").none(),
               "Sizes: picture=H,W,C truth=H,W,C out_gradient=H,W,C");
}

}  // namespace fourd
