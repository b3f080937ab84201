"""The kernels compared with the reference: values, gradients, threads, and the operator's contract."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.triangles import texture, texture_construct_mip
from tests.ops.texture.inputs import BOUNDARIES, FILTERS, Lookup, random_lookup, values_and_gradients

NAMES = ("picture", "tex", "uv", "uv_da", "mip_level_bias")


def assert_equal_but_for_rounding(found: list[Tensor], expected: list[Tensor]) -> None:
    """Positions at a boundary between texels or levels may round to either side, so a few values may differ."""
    for name, one, other in zip(NAMES, found, expected, strict=True):
        scale = max(float(other.abs().max()), 1e-6)
        differs = ((one - other).abs() > 2e-5 * scale + 1e-4 * other.abs()).float().mean()
        assert differs < 2e-3, f"{name}: {100 * float(differs):.2f} % of the values differ"


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize("boundary_mode", BOUNDARIES)
@pytest.mark.parametrize("filter_mode", FILTERS)
def test_kernel_equals_the_reference(
    filter_mode: str, boundary_mode: str, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches wrong weights, texels and levels in any mode, for numbers of channels with and without specialised
    code.
    """
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    for channels, items in ((1, 1), (3, 2), (4, 1), (6, 2)):
        lookup = random_lookup(rng, boundary_mode, channels, items=items)
        upstream = torch.from_numpy(rng.standard_normal((2, 30, 40, channels)).astype(np.float32))
        results = [
            values_and_gradients(lookup, upstream, filter_mode, boundary_mode, backend=backend)
            for backend in ("cpu", "reference")
        ]
        assert_equal_but_for_rounding(*results)


@pytest.mark.parametrize("boundary_mode", BOUNDARIES)
@pytest.mark.parametrize("filter_mode", FILTERS)
def test_gpu_equals_the_reference(
    filter_mode: str, boundary_mode: str, gpu: torch.device, rng: np.random.Generator
) -> None:
    """Catches texels, levels and gradients of the CUDA kernels that differ from the reference, in any mode."""
    lookup = random_lookup(rng, boundary_mode, 3, items=int(rng.integers(1, 3)), picture=(20, 30))
    upstream = torch.from_numpy(rng.standard_normal((2, 20, 30, 3)).astype(np.float32))
    on_gpu = Lookup(*(one.to(gpu) for one in lookup.tensors))
    found = values_and_gradients(on_gpu, upstream.to(gpu), filter_mode, boundary_mode)
    expected = values_and_gradients(lookup, upstream, filter_mode, boundary_mode, backend="reference")
    assert_equal_but_for_rounding([one.cpu() for one in found], expected)


def test_gpu_gives_own_mips_their_own_gradients(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches gradients of given mip levels that the CUDA kernels add to the gradient of the texture."""
    base, mips = torch.ones(1, 4, 4, 2), [torch.ones(1, 2, 2, 2), torch.ones(1, 1, 1, 2)]
    leaves = [one.to(gpu).requires_grad_() for one in (base, *mips)]
    bias = torch.full((1, 5, 5), 1.25, device=gpu)
    uv = torch.from_numpy(rng.uniform(0, 1, (1, 5, 5, 2)).astype(np.float32)).to(gpu)
    out = texture(leaves[0], uv, None, bias, leaves[1:])
    sums = [float(one.sum()) for one in torch.autograd.grad(out.sum(), leaves)]
    assert sums == pytest.approx([0, 0.75 * 50, 0.25 * 50], abs=1e-4)


def test_large_textures_equal_the_reference(rng: np.random.Generator) -> None:
    """The backward pass divides a texture into bands. Catches wrong gradients of texels at the borders of bands, and in
    bands whose pixels are summed in several parts.
    """
    lookup = random_lookup(rng, "wrap", 3, items=1, picture=(200, 320), size=(128, 256))
    # Many pixels read the same few texels.
    lookup.uv[0, :, :100] *= 0.01
    upstream = torch.from_numpy(rng.standard_normal((2, 200, 320, 3)).astype(np.float32))
    results = [
        values_and_gradients(lookup, upstream, "linear-mipmap-linear", "wrap", backend=backend)
        for backend in ("cpu", "reference")
    ]
    assert_equal_but_for_rounding(*results)
    torch.testing.assert_close(results[0][1], results[1][1], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("boundary_mode", ["wrap", "cube"])
def test_any_thread_count_gives_the_same_bits(boundary_mode: str, rng: np.random.Generator) -> None:
    """Catches threads that add gradients to the same texel in random order."""
    lookup = random_lookup(rng, boundary_mode, items=1, picture=(200, 320), size=(64, 128))
    upstream = torch.from_numpy(rng.standard_normal((2, 200, 320, 3)).astype(np.float32))
    results = [
        values_and_gradients(lookup, upstream, "linear-mipmap-linear", boundary_mode, threads=threads)
        for threads in (1, 2, 5)
    ]
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_mip_gives_the_values_and_gradients_of_a_built_in_chain(backend: str, rng: np.random.Generator) -> None:
    """Catches a mip chain that passes no gradient to the texture, and a mip chain with a wrong number of levels."""
    for boundary_mode in ("wrap", "cube"):
        lookup = random_lookup(rng, boundary_mode)
        upstream = torch.from_numpy(rng.standard_normal((2, 30, 40, 3)).astype(np.float32))
        expected = values_and_gradients(lookup, upstream, "auto", boundary_mode, backend=backend, max_mip_level=2)
        mip = texture_construct_mip(lookup.tex, 2, boundary_mode == "cube", backend=backend)
        assert not any(level.requires_grad for level in mip.levels)
        leaves = [one.clone().requires_grad_() for one in lookup.tensors]
        out = texture(*leaves, mip, boundary_mode=boundary_mode, backend=backend)  # type: ignore[arg-type]
        found = [out.detach(), *torch.autograd.grad(out, leaves, upstream)]
        for one, other in zip(found, expected, strict=True):
            torch.testing.assert_close(one, other)


def test_own_mips_get_their_own_gradients(rng: np.random.Generator) -> None:
    """Catches gradients of given mip levels that are lost or added to the gradient of the texture."""
    lookup = random_lookup(rng, "clamp", items=1)
    mips = [torch.from_numpy(rng.standard_normal(shape).astype(np.float32)) for shape in ((1, 4, 8, 3), (1, 2, 4, 3))]
    upstream = torch.from_numpy(rng.standard_normal((2, 30, 40, 3)).astype(np.float32))
    results = []
    for backend in ("cpu", "reference"):
        leaves = [one.clone().requires_grad_() for one in (*lookup.tensors, *mips)]
        out = texture(*leaves[:4], leaves[4:], boundary_mode="clamp", backend=backend)  # type: ignore[arg-type]
        results.append([out, *torch.autograd.grad(out, leaves, upstream)])
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-3 * float(other.detach().abs().max()))
    assert results[0][-1].abs().max() > 0.1


def test_pixels_of_zero_gradient_change_nothing(rng: np.random.Generator) -> None:
    """Catches pixels with a zero gradient in one channel only that are skipped like pixels of the background."""
    lookup = random_lookup(rng, "wrap")
    upstream = torch.from_numpy(rng.standard_normal((2, 30, 40, 3)).astype(np.float32))
    upstream[:, :10] = 0
    upstream[:, 10:20, :, :2] = 0
    found, expected = (
        values_and_gradients(lookup, upstream, "auto", "wrap", backend=backend) for backend in ("cpu", "reference")
    )
    assert_equal_but_for_rounding(found, expected)


def test_empty_pictures_give_zero_gradients() -> None:
    """Catches gradients that are not initialised if there are no pixels."""
    tex = torch.ones(1, 8, 8, 3, requires_grad=True)
    for shape in ((0, 4, 4), (1, 0, 4)):
        found = texture(tex, torch.zeros(*shape, 2), torch.zeros(*shape, 4))
        assert found.shape == (*shape, 3)
        (gradient,) = torch.autograd.grad(found.sum(), tex)
        assert not gradient.any()


def test_operators_pass_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    for boundary_mode in ("wrap", "cube"):
        lookup = random_lookup(rng, boundary_mode, picture=(3, 4))
        mip = texture_construct_mip(lookup.tex, 2, boundary_mode == "cube")
        tensors = [one.requires_grad_() for one in lookup.tensors]
        modes = ("linear-mipmap-linear", boundary_mode)
        sample = torch.ops.fourd.sample_texture.default
        torch.library.opcheck(sample, (tensors[0], list(mip.levels), *tensors[1:], *modes, True, 1))
        own = [level.clone().requires_grad_() for level in mip.levels]
        torch.library.opcheck(sample, (tensors[0], own, *tensors[1:], *modes, False, 1))
        torch.library.opcheck(torch.ops.fourd.build_texture_mips.default, (lookup.tex.detach(), 3, 1))
    plain = Lookup(*(one.detach() for one in random_lookup(rng, "wrap", picture=(3, 4)).tensors))
    arguments = (plain.tex.requires_grad_(), [], plain.uv, None, None, "nearest", "clamp", True, 0)
    torch.library.opcheck(torch.ops.fourd.sample_texture.default, arguments)
