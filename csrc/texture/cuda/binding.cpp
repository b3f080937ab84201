// Python bindings of texture lookups on a GPU; fourd/rendering/ops/texture/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "binding/cuda_arrays.h"
#include "texture/arguments.h"
#include "texture/cuda/sample.h"

namespace nb = nanobind;

namespace fourd::cuda {
namespace {

using Arguments = TextureArguments<Where>;

void sample_texture(const std::vector<Arguments::Level>& levels, const Arguments::Pixels& uv,
                    const std::optional<Arguments::Pixels>& uv_da, const std::optional<Arguments::Bias>& bias,
                    const std::string& filter, const std::string& boundary, std::uintptr_t stream,
                    const Arguments::PixelsOut& out) {
    const Arguments arguments(levels, uv, uv_da, bias, filter, boundary, 1, Simd::baseline);
    arguments.require_picture(out, "out: unexpected shape");
    texture::cuda::sample(arguments.query, out.data(), stream_of(stream));
}

void sample_texture_backward(const std::vector<Arguments::Level>& levels, const Arguments::Pixels& uv,
                             const std::optional<Arguments::Pixels>& uv_da, const std::optional<Arguments::Bias>& bias,
                             const std::string& filter, const std::string& boundary, std::uintptr_t stream,
                             const Arguments::Pixels& gradient, bool is_chain,
                             const std::vector<Arguments::LevelOut>& out_levels,
                             const std::optional<Arguments::PixelsOut>& out_uv,
                             const std::optional<Arguments::PixelsOut>& out_uv_da,
                             const std::optional<Arguments::BiasOut>& out_bias) {
    const Arguments arguments(levels, uv, uv_da, bias, filter, boundary, 1, Simd::baseline);
    arguments.require_picture(gradient, "gradient: unexpected shape");
    if (is_chain) Arguments::require_chain(arguments.query.texture.shape);
    texture::cuda::sample_backward(arguments.query, gradient.data(), is_chain,
                                   arguments.gradients(out_levels, out_uv, out_uv_da, out_bias), stream_of(stream));
}

void build_mips(const Arguments::Level& texture, std::uintptr_t stream, const std::vector<Arguments::LevelOut>& out) {
    const texture::Shape shape = Arguments::shape_of_chain(texture, out);
    std::vector<float*> mips;
    for (const Arguments::LevelOut& level : out) mips.push_back(level.data());
    texture::cuda::build_mips(shape, texture.data(), mips.data(), stream_of(stream));
}

}  // namespace

void bind_texture(nb::module_& module) {
    module.def("sample_texture", &sample_texture, nb::arg("levels"), nb::arg("uv"), nb::arg("uv_da").none(),
               nb::arg("bias").none(), nb::arg("filter"), nb::arg("boundary"), nb::arg("stream"), nb::arg("out"));
    module.def("sample_texture_backward", &sample_texture_backward, nb::arg("levels"), nb::arg("uv"),
               nb::arg("uv_da").none(), nb::arg("bias").none(), nb::arg("filter"), nb::arg("boundary"),
               nb::arg("stream"), nb::arg("gradient"), nb::arg("is_chain"), nb::arg("out_levels"),
               nb::arg("out_uv").none(), nb::arg("out_uv_da").none(), nb::arg("out_bias").none());
    module.def("build_mips", &build_mips, nb::arg("texture"), nb::arg("stream"), nb::arg("out"));
}

}  // namespace fourd::cuda
