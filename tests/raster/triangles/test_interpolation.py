"""Values and gradients of `interpolate`, compared with the reference and with finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.interpolate.op import interpolate_attributes
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.meshes.ids import encode_ids
from fourd.rendering.triangles import interpolate, rasterize
from tests.raster.triangles.scenes import soup

SIZE = (45, 70)
Diff = list[int] | str | None


def drawn(rng: np.random.Generator, images: int = 2) -> tuple[Tensor, Tensor, Tensor]:
    """Return rast, rast_db and tri of random triangles."""
    pos, tri = soup(rng, images, triangles=25)
    rast, rast_db = rasterize(pos, tri, SIZE)
    return rast, rast_db, tri


def normal(rng: np.random.Generator, *shape: int) -> Tensor:
    return torch.from_numpy(rng.standard_normal(shape).astype(np.float32))


def results(attr: Tensor, images: tuple[Tensor, Tensor, Tensor], diff: Diff, backend: str) -> list[Tensor]:
    """Return the outputs and the gradients of attr, rast and rast_db. The upstream gradients depend only on the shapes
    of the outputs.
    """
    rast, rast_db, tri = images
    leaves = [tensor.clone().requires_grad_() for tensor in (attr, rast, rast_db)]
    outputs = interpolate(leaves[0], leaves[1], tri, leaves[2], diff, backend=backend)
    generator = torch.Generator().manual_seed(1)
    upstream = [torch.randn(output.shape, generator=generator).to(attr.device) for output in outputs]
    used = 2 if outputs[1].requires_grad else 1  # Without derivatives, the reference's out_da is a constant.
    gradients = torch.autograd.grad(outputs[:used], leaves, upstream[:used], allow_unused=True)
    found = [torch.zeros_like(leaf) if grad is None else grad for grad, leaf in zip(gradients, leaves, strict=True)]
    return [output.detach() for output in outputs] + found


def assert_close(found: list[Tensor], expected: list[Tensor]) -> None:
    for one, other in zip(found, expected, strict=True):
        scale = float(other.abs().max()) if other.numel() else 0.0
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize("channels", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("shared", ["", "one mesh", "no batch axis"])
def test_kernel_equals_the_reference(
    channels: int, shared: str, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches swapped vertices, gradients that are not summed over images with common attributes, and derivatives of
    the wrong channel.
    """
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    images = drawn(rng)
    attr = normal(rng, *{"": (2, 40), "one mesh": (1, 40), "no batch axis": (40,)}[shared], channels)
    for diff in (None, "all", [channels - 1, 0, -1]):
        found = results(attr, images, diff, "cpu")
        assert_close(found, results(attr, images, diff, "reference"))
        if diff is not None:
            assert found[4].any()


@pytest.mark.parametrize("images", [1, 2])
def test_gpu_equals_the_reference(
    images: int, gpu: torch.device, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches attributes of the wrong image, and gradients that are not cleared."""
    attr = normal(rng, images, 40, 3)
    monkeypatch.delenv("FOURD_SIMD", raising=False)
    drawing = drawn(rng)
    if gpu.type == "cpu":
        monkeypatch.setenv("FOURD_SIMD", "emulated")
    on_gpu = (drawing[0].to(gpu), drawing[1].to(gpu), drawing[2].to(gpu))
    for diff in (None, [2, 0, -1]):
        found = [value.cpu() for value in results(attr.to(gpu), on_gpu, diff, "auto")]
        assert_close(found, results(attr, drawing, diff, "reference"))


def test_gradient_equals_finite_differences(rng: np.random.Generator) -> None:
    """Catches an error that the kernel and the reference have in common. The outputs are linear in each input, so
    finite differences are exact.
    """
    rast, rast_db, tri = drawn(rng, 1)
    attr = normal(rng, 1, 40, 3)
    inputs = [attr, rast, rast_db]
    upstream = [normal(rng, 1, *SIZE, 3), normal(rng, 1, *SIZE, 6)]

    def total(values: list[Tensor]) -> float:
        attr, rast, rast_db = (value.double() for value in values)
        outputs = interpolate(attr, rast, tri, rast_db, "all", backend="reference")
        return sum(float((output * weight).sum()) for output, weight in zip(outputs, upstream, strict=True))

    leaves = [value.clone().requires_grad_() for value in inputs]
    outputs = interpolate(leaves[0], leaves[1], tri, leaves[2], "all")
    gradients = torch.autograd.grad(outputs, leaves, upstream)
    assert not gradients[1][..., 2:].any()
    for k, (value, gradient) in enumerate(zip(inputs, gradients, strict=True)):
        direction = normal(rng, *value.shape)
        if k == 1:
            direction[..., 2:] = 0
        shifted = [[v + sign * direction if j == k else v for j, v in enumerate(inputs)] for sign in (1, -1)]
        slope = (total(shifted[0]) - total(shifted[1])) / 2
        assert float((gradient.double() * direction).sum()) == pytest.approx(slope, rel=1e-3, abs=1e-2)


def test_derivatives_are_differences_between_neighbours(rng: np.random.Generator) -> None:
    """Catches swapped X and Y, and derivatives per image instead of per pixel. A linear function of the screen has
    exact differences."""
    xy = torch.tensor([[-1.5, -1.5], [4.0, -1.0], [-1.0, 4.0]])
    pos = torch.cat([xy, torch.zeros(3, 1), torch.ones(3, 1)], 1)[None]
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    rast, rast_db = rasterize(pos, tri, SIZE)
    out, out_da = interpolate(normal(rng, 3, 2), rast, tri, rast_db, "all")
    torch.testing.assert_close(out_da[0, :, :-1, 0::2], out[0, :, 1:] - out[0, :, :-1], rtol=1e-3, atol=1e-5)
    torch.testing.assert_close(out_da[0, :-1, :, 1::2], out[0, 1:] - out[0, :-1], rtol=1e-3, atol=1e-5)


def test_any_number_of_threads_gives_the_same_bits(rng: np.random.Generator) -> None:
    """Catches sums whose order depends on the threads."""
    rast, _, tri = drawn(rng, 3)
    found = []
    for threads in (1, 2, 5):
        attr, leaf = normal(np.random.default_rng(5), 40, 3).requires_grad_(), rast.clone().requires_grad_()
        out, _ = interpolate(attr, leaf, tri, threads=threads)
        found.append((out, *torch.autograd.grad((out**2).sum(), (attr, leaf))))
    for other in found[1:]:
        assert all(torch.equal(one, two) for one, two in zip(found[0], other, strict=True))


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_ids_without_a_triangle_are_background(backend: str) -> None:
    """Catches reads out of range for ids of another mesh, ids above 2^24, and NaN."""
    rast = torch.zeros(1, 1, 6, 4)
    rast[..., :2] = 0.25
    ids = encode_ids(torch.tensor([0, 1, 2, 2**24 + 3, -1]))
    rast[0, 0, :, 3] = torch.cat([ids, torch.tensor([torch.nan])])
    tri = torch.tensor([[0, 1, 2], [2, 1, 0]], dtype=torch.int32)
    attr = torch.tensor([[1.0], [2.0], [4.0]])
    out, _ = interpolate(attr, rast, tri, backend=backend)
    torch.testing.assert_close(out[0, 0, :, 0], torch.tensor([2.75, 2.0, 0, 0, 0, 0]))


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a wrong fake implementation, and an operator that changes its inputs or returns one of them."""
    rast, rast_db, tri = drawn(rng)
    attr = normal(rng, 1, 40, 3).requires_grad_()
    rast.requires_grad_()
    torch.library.opcheck(interpolate_attributes.defined, (attr, rast, tri, None, [], 0))
    torch.library.opcheck(interpolate_attributes.defined, (attr, rast, tri, rast_db.requires_grad_(), [2, 0], 0))


def test_wrong_arguments_are_named(rng: np.random.Generator) -> None:
    """Catches out-of-range reads and unclear errors."""
    rast, rast_db, tri = drawn(rng)
    attr = normal(rng, 40, 3)
    with pytest.raises(ValueError, match="attr: expected 1 or 2 meshes, as rast has images, got 3"):
        interpolate(normal(rng, 3, 40, 3), rast, tri)
    with pytest.raises(ValueError, match=r"rast: expected shape \(B, H, W, 4\), got \(2, 45, 70, 3\)"):
        interpolate(attr, rast[..., :3], tri)
    with pytest.raises(ValueError, match="tri: expected vertex indices from 0 to 9, got"):
        interpolate(attr[:10], rast, tri)
    with pytest.raises(ValueError, match="rast_db: expected the derivatives from rasterize"):
        interpolate(attr, rast, tri, diff_attrs="all")
    with pytest.raises(ValueError, match=r"rast_db: expected shape \(2, 45, 70, 4\), got \(1, 45, 70, 4\)"):
        interpolate(attr, rast, tri, rast_db[:1], [0])
    with pytest.raises(ValueError, match="diff_attrs: expected channels from -3 to 2, got 3"):
        interpolate(attr, rast, tri, rast_db, [3])
    with pytest.raises(ValueError, match="diff_attrs: expected a list of channels or 'all', got 'some'"):
        interpolate(attr, rast, tri, rast_db, "some")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="rast: expected dtype float32, got float64"):
        interpolate(attr, rast.double(), tri)
    with pytest.raises(ValueError, match="diff: expected indices of channels"):
        interpolate_attributes(attr[None], rast, tri, rast_db, [3], 0)
