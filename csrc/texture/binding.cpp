// Python bindings of texture lookups; fourd/rendering/ops/texture/op.py documents the operations.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "texture/arguments.h"

namespace nb = nanobind;

namespace fourd {
namespace {

using Arguments = TextureArguments<nb::device::cpu>;

void sample_texture(const std::vector<Arguments::Level>& levels, const Arguments::Pixels& uv,
                    const std::optional<Arguments::Pixels>& uv_da, const std::optional<Arguments::Bias>& bias,
                    const std::string& filter, const std::string& boundary, int threads, const std::string& simd,
                    const Arguments::PixelsOut& out) {
    const Arguments arguments(levels, uv, uv_da, bias, filter, boundary, clamp_threads(threads),
                              simd_named(simd.c_str()));
    arguments.require_picture(out, "out: unexpected shape");
    nb::gil_scoped_release release;
    texture::sample(arguments.query, out.data());
}

void sample_texture_backward(const std::vector<Arguments::Level>& levels, const Arguments::Pixels& uv,
                             const std::optional<Arguments::Pixels>& uv_da, const std::optional<Arguments::Bias>& bias,
                             const std::string& filter, const std::string& boundary, int threads,
                             const std::string& simd, const Arguments::Pixels& gradient, bool is_chain,
                             const std::vector<Arguments::LevelOut>& out_levels,
                             const std::optional<Arguments::PixelsOut>& out_uv,
                             const std::optional<Arguments::PixelsOut>& out_uv_da,
                             const std::optional<Arguments::BiasOut>& out_bias) {
    const Arguments arguments(levels, uv, uv_da, bias, filter, boundary, clamp_threads(threads),
                              simd_named(simd.c_str()));
    arguments.require_picture(gradient, "gradient: unexpected shape");
    if (is_chain) Arguments::require_chain(arguments.query.texture.shape);
    const texture::Gradients out = arguments.gradients(out_levels, out_uv, out_uv_da, out_bias);
    nb::gil_scoped_release release;
    texture::sample_backward(arguments.query, gradient.data(), is_chain, out);
}

void build_mips(const Arguments::Level& texture, int threads, const std::string& simd,
                const std::vector<Arguments::LevelOut>& out) {
    const texture::Shape shape = Arguments::shape_of_chain(texture, out);
    std::vector<float*> mips;
    for (const Arguments::LevelOut& level : out) mips.push_back(level.data());
    const int team = clamp_threads(threads);
    const Simd set = simd_named(simd.c_str());
    nb::gil_scoped_release release;
    texture::build_mips(shape, texture.data(), mips.data(), team, set);
}

}  // namespace

void bind_texture(nb::module_& module) {
    module.def("sample_texture", &sample_texture, nb::arg("levels"), nb::arg("uv"), nb::arg("uv_da").none(),
               nb::arg("bias").none(), nb::arg("filter"), nb::arg("boundary"), nb::arg("threads"), nb::arg("simd"),
               nb::arg("out"),
               "Documented in fourd.rendering.ops.texture.op.\n"
               "Sizes: levels*L=I,1,H>,W>,C uv=I,N,2 uv_da=I,N,4 bias=I,N out=I,N,C\n"
               "Sizes: levels*L=1,6,H>,H>,C uv=I,N,3 uv_da=I,N,6 bias=I,N out=I,N,C");
    module.def("sample_texture_backward", &sample_texture_backward, nb::arg("levels"), nb::arg("uv"),
               nb::arg("uv_da").none(), nb::arg("bias").none(), nb::arg("filter"), nb::arg("boundary"),
               nb::arg("threads"), nb::arg("simd"), nb::arg("gradient"), nb::arg("is_chain"), nb::arg("out_levels"),
               nb::arg("out_uv").none(), nb::arg("out_uv_da").none(), nb::arg("out_bias").none(),
               "Sizes: levels*L=I,1,H>,W>,C uv=I,N,2 uv_da=I,N,4 bias=I,N gradient=I,N,C out_levels*L=I,1,H>,W>,C "
               "out_uv=I,N,2 out_uv_da=I,N,4 out_bias=I,N\n"
               "Sizes: levels*L=1,6,H>,H>,C uv=I,N,3 uv_da=I,N,6 bias=I,N gradient=I,N,C out_levels*L=1,6,H>,H>,C "
               "out_uv=I,N,3 out_uv_da=I,N,6 out_bias=I,N");
    module.def("build_mips", &build_mips, nb::arg("texture"), nb::arg("threads"), nb::arg("simd"), nb::arg("out"),
               "Sizes: texture=I,1,2H,2W,C out*L=I,1,H>,W>,C\n"
               "Sizes: texture=I,6,2H,2H,C out*L=I,6,H>,H>,C");
}

}  // namespace fourd
