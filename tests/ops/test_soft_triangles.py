"""The kernels of soft rasterization compared with the reference. The CUDA kernels run in the emulator, and on a GPU if
there is one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.points.validation import pack_camera
from fourd.rendering.ops.soft_triangles import op
from fourd.rendering.ops.soft_triangles.softness import Softness
from fourd.rendering.triangles import rasterize_soft
from tests.raster.clouds import turned_camera
from tests.raster.triangles.soups import Soup, random_soup

SIMD = ("baseline", "avx2", "avx512")
DISTANCES = ("euclidean", "barycentric")
SOFT = {"sigma": 1e-3, "gamma": 1e-2, "far": 10.0}
Result = tuple[list[Tensor], list[Tensor]]


def run(
    soup: Soup,
    size: tuple[int, int],
    backend: str,
    *,
    outputs: tuple[int, ...] = (0, 1),
    dtype: torch.dtype = torch.float32,
    device: torch.device | None = None,
    **settings: Any,
) -> Result:
    """Return features and alpha, and the gradients of a random linear function of ``outputs``."""
    xyz, features = (array.to(device, dtype, copy=True).requires_grad_() for array in (soup.xyz, soup.features))
    images = rasterize_soft(
        xyz,
        soup.tri.to(device),
        features,
        turned_camera(*size),
        backend=backend,  # type: ignore[arg-type]
        **{**SOFT, **settings},
    )
    rng = np.random.default_rng(7)
    total = torch.zeros((), dtype=dtype, device=device)
    for index, image in enumerate(images):
        weights = torch.from_numpy(rng.normal(size=tuple(image.shape)).astype(np.float32)).to(image)
        if index in outputs:
            total = total + (image * weights).sum()
    gradients = torch.autograd.grad(total, (xyz, features), materialize_grads=True)
    return [image.detach().cpu() for image in images], [gradient.cpu() for gradient in gradients]


def assert_parity(got: Result, wanted: Result) -> None:
    """Assert that images match within 5e-5, and gradients within 1e-3 of the largest gradient in the
    array. The soups contain triangles that are hundreds of pixels wide. At this size, float32 resolves the positions of
    edges to 3e-5 pixels."""
    for name, value, expected in zip(("features", "alpha"), got[0], wanted[0], strict=True):
        assert float((value - expected).abs().max()) <= 5e-5, name
    for name, value, expected in zip(("xyz", "features"), got[1], wanted[1], strict=True):
        worst, scale = float((value - expected).abs().max()), float(expected.abs().max())
        assert worst <= 1e-3 * scale, f"{name}: off by {worst:.3g} at a scale of {scale:.3g}"


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("count", "size", "layers"), [(120, (41, 35), None), (90, (16, 16), 1), (90, (3, 50), 7)])
def test_images_and_gradients_equal_the_reference(
    count: int, size: tuple[int, int], layers: int | None, seed: int, distance: str
) -> None:
    """Catches wrong distances, wrong selections of the nearest triangles, wrong tiles and missing terms of
    gradients.
    """
    soup = random_soup(np.random.default_rng(seed), count)
    settings = {"layers": layers, "distance": distance}
    wanted = run(soup, size, "reference", **settings)
    assert float(wanted[0][1].max()) > 0.5
    assert_parity(run(soup, size, "cpu", **settings), wanted)


@pytest.mark.parametrize("channels", [1, 2, 4, 32])
@pytest.mark.parametrize("outputs", [(0,), (1,)])
def test_channel_counts_and_outputs(channels: int, outputs: tuple[int, ...]) -> None:
    """Catches a wrong stride, and a gradient that ignores one of the outputs."""
    soup = random_soup(np.random.default_rng(channels), 60, channels)
    got = run(soup, (19, 18), "cpu", outputs=outputs)
    assert_parity(got, run(soup, (19, 18), "reference", outputs=outputs))


@pytest.mark.parametrize("changes", [{"sigma": 1e-5}, {"sigma": 0.1}, {"gamma": 1.0}, {"cutoff": 0.2}, {"eps": 0.9}])
def test_parameters(changes: dict[str, float]) -> None:
    """Catches a parameter whose unit differs between the kernel and the reference."""
    soup = random_soup(np.random.default_rng(8), 60)
    assert_parity(run(soup, (30, 22), "cpu", **changes), run(soup, (30, 22), "reference", **changes))


@pytest.mark.parametrize("distance", DISTANCES)
def test_gradients_equal_finite_differences(distance: Any) -> None:
    """Catches an error that kernel and reference share."""
    rng = np.random.default_rng(3)
    corners = rng.uniform([-0.8, -0.8, -0.5], [0.8, 0.8, 0.5], (5, 3, 3)).reshape(-1, 3)
    tri = torch.arange(15, dtype=torch.int32).reshape(5, 3)
    free = [torch.from_numpy(corners).requires_grad_(), torch.from_numpy(rng.random((5, 2))).requires_grad_()]
    weights = torch.from_numpy(rng.normal(size=(10, 12, 3)))

    def loss(xyz: Tensor, features: Tensor) -> Tensor:
        # With wide edges and a small cutoff, small steps do not change which triangles affect a pixel.
        image, alpha = rasterize_soft(
            xyz,
            tri,
            features,
            turned_camera(12, 10),
            sigma=0.5,
            gamma=0.1,
            far=10,
            cutoff=1e-30,
            distance=distance,
            backend="reference",
        )
        return (torch.cat([image, alpha[..., None]], dim=-1) * weights).sum()

    assert torch.autograd.gradcheck(loss, free, eps=1e-7, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("simd", SIMD)
def test_instruction_sets_and_threads_give_the_same_bits(simd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches sums whose order depends on the thread or on the width of the vectors."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    soup = random_soup(np.random.default_rng(11), 200)
    wanted = run(soup, (75, 61), "cpu", threads=1, layers=5)
    monkeypatch.setenv("FOURD_SIMD", simd)
    for threads in (1, 2, 5):
        got = run(soup, (75, 61), "cpu", threads=threads, layers=5)
        for one, other in zip((*got[0], *got[1]), (*wanted[0], *wanted[1]), strict=True):
            assert torch.equal(one, other)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_ties_go_to_the_smaller_index(backend: str) -> None:
    """Catches a selection of the nearest triangles that depends on the order of triangles with equal depths."""
    corners = torch.tensor([[-1.0, -1.0, 0], [1.0, -1.0, 0], [0.0, 1.5, 0]])
    soup = Soup(corners, torch.tensor([[0, 1, 2]] * 3, dtype=torch.int32), torch.eye(3), torch.ones(3), torch.ones(3))
    features = run(soup, (9, 9), backend, layers=2)[0][0]
    torch.testing.assert_close(features[4, 4], torch.tensor([0.5, 0.5, 0.0]), atol=1e-4, rtol=0)


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize(("count", "size", "layers"), [(100, (41, 35), None), (60, (16, 16), 1), (40, (3, 50), 4)])
def test_cuda_equals_the_reference(
    count: int, size: tuple[int, int], layers: int | None, distance: str, gpu: torch.device
) -> None:
    """Catches pixels of the wrong tile, wrong selections of triangles, errors from diverging warps, and missing terms
    in sums.
    """
    soup = random_soup(np.random.default_rng(count), count)
    settings = {"layers": layers, "distance": distance}
    assert_parity(run(soup, size, "auto", device=gpu, **settings), run(soup, size, "reference", **settings))


@pytest.mark.parametrize("channels", [1, 5, 32])
def test_cuda_channel_counts(channels: int, gpu: torch.device) -> None:
    """Catches a wrong stride in the general kernel."""
    soup = random_soup(np.random.default_rng(channels), 40, channels)
    assert_parity(run(soup, (19, 18), "auto", device=gpu), run(soup, (19, 18), "reference"))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 3e38, -3e38])
@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_invalid_triangles_change_nothing_and_get_no_gradient(bad: float, backend: str) -> None:
    """Catches NaN images and NaN gradients of culled triangles."""
    soup = random_soup(np.random.default_rng(4), 60)
    clean = run(soup, (40, 30), backend)
    more = replace(
        soup,
        xyz=torch.cat([soup.xyz, torch.full((3, 3), bad), torch.zeros(6, 3)]),
        tri=torch.cat([soup.tri, torch.tensor([[180, 181, 182], [183, 184, 185]], dtype=torch.int32)]),
        features=torch.cat([soup.features, torch.ones(2, 3)]),
    )
    images, gradients = run(more, (40, 30), backend)
    for got, expected in zip(images, clean[0], strict=True):
        torch.testing.assert_close(got, expected, atol=1e-6, rtol=0)
    for gradient, expected in zip(gradients, clean[1], strict=True):
        assert torch.equal(gradient[len(expected) :], torch.zeros_like(gradient[len(expected) :]))
        torch.testing.assert_close(gradient[: len(expected)], expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_no_triangles(backend: str) -> None:
    """Catches an error or a wrong image if there are no triangles."""
    soup = Soup(
        torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.int32), torch.zeros(0, 2), torch.ones(0), torch.ones(0)
    )
    images, gradients = run(soup, (20, 10), backend)
    assert all(float(image.abs().sum()) == 0 for image in images)
    assert [gradient.shape[0] for gradient in gradients] == [0, 0]


def test_opcheck() -> None:
    """Catches fake shapes, mutations and autograd registrations that torch.compile cannot use."""
    soup = random_soup(np.random.default_rng(0), 20)
    softness = Softness(False, 1e-3, 1e-2, 1e-4, 0.01, 10.0, 1e-3).pack()
    inputs = (soup.xyz.requires_grad_(), soup.tri, soup.features.requires_grad_())
    torch.library.opcheck(op.rasterize.defined, (*inputs, pack_camera(turned_camera(20, 12)), 20, 12, softness, 5, 1))
