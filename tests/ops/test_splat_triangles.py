"""The kernels of triangle splatting compared with the reference. The CUDA kernels run in the emulator, and on a GPU if
there is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.points.validation import pack_camera
from fourd.rendering.ops.splat_triangles import op
from fourd.rendering.triangles import splat_triangles
from tests.raster.clouds import turned_camera
from tests.raster.triangles.soups import NAMES, Soup, random_soup

SIMD = ("baseline", "avx2", "avx512")
OUTPUTS = ("features", "alpha", "depth", "normal")
Result = tuple[list[Tensor], list[Tensor]]


def run(
    soup: Soup,
    size: tuple[int, int],
    backend: str,
    *,
    outputs: tuple[str, ...] = OUTPUTS,
    layers: int | None = None,
    geometry: bool = True,
    threads: int = 0,
    dtype: torch.dtype = torch.float32,
    device: torch.device | None = None,
) -> Result:
    """Return the images and the weights, and the gradients of a random linear function of ``outputs``."""
    xyz, features, opacity, sigma = (array.to(device, dtype, copy=True).requires_grad_() for array in soup.floats)
    image = splat_triangles(
        xyz,
        soup.tri.to(device),
        features,
        opacity,
        sigma,
        turned_camera(*size),
        layers=layers,
        geometry=geometry,
        backend=backend,  # type: ignore[arg-type]
        threads=threads,
    )
    rng = np.random.default_rng(7)
    total = torch.zeros((), dtype=dtype, device=device)
    images = [getattr(image, name) for name in OUTPUTS if getattr(image, name) is not None]
    for name, values in zip(OUTPUTS, images, strict=False):
        weights = torch.from_numpy(rng.normal(size=tuple(values.shape)).astype(np.float32)).to(values)
        if name in outputs:
            total = total + (values * weights).sum()
    gradients = torch.autograd.grad(total, (xyz, features, opacity, sigma), materialize_grads=True)
    return [value.detach().cpu() for value in (*images, image.weight)], [gradient.cpu() for gradient in gradients]


def assert_parity(got: Result, wanted: Result) -> None:
    """Assert that images and gradients match. The tolerance is 2e-5 for images. For gradients, the tolerance is 2e-4
    of the largest gradient in the array."""
    for name, value, expected in zip((*OUTPUTS, "weight"), got[0], wanted[0], strict=False):
        scale = max(1.0, float(expected.abs().max())) if expected.numel() else 1.0
        assert float((value - expected).abs().max()) <= 2e-5 * scale, name
    for name, value, expected in zip(NAMES, got[1], wanted[1], strict=True):
        worst, scale = float((value - expected).abs().max()), float(expected.abs().max())
        assert worst <= 2e-4 * scale, f"{name}: off by {worst:.3g} at a scale of {scale:.3g}"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("count", "size", "layers"), [(200, (41, 35), None), (90, (16, 16), 1), (90, (3, 50), 7)])
def test_images_and_gradients_equal_the_reference(
    count: int, size: tuple[int, int], layers: int | None, seed: int
) -> None:
    """Catches wrong window functions, a wrong compositing order, wrong tiles and missing terms of gradients."""
    soup = random_soup(np.random.default_rng(seed), count)
    wanted = run(soup, size, "reference", layers=layers)
    assert float(wanted[0][1].max()) > 0.5
    assert_parity(run(soup, size, "cpu", layers=layers), wanted)


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 7, 32])
@pytest.mark.parametrize("geometry", [False, True])
def test_channel_counts(channels: int, geometry: bool) -> None:
    """Catches a wrong stride in the general loop. There are separate loops for 3 channels with and without geometry."""
    soup = random_soup(np.random.default_rng(channels), 60, channels)
    outputs = OUTPUTS if geometry else ("features", "alpha")
    got = run(soup, (19, 18), "cpu", geometry=geometry, outputs=outputs)
    assert_parity(got, run(soup, (19, 18), "reference", geometry=geometry, outputs=outputs))


@pytest.mark.parametrize("outputs", [(name,) for name in OUTPUTS])
def test_gradient_of_each_output_alone(outputs: tuple[str, ...]) -> None:
    """Catches a gradient that ignores one of the outputs, and errors in small gradients that are hidden by large
    gradients.
    """
    soup = random_soup(np.random.default_rng(5), 150)
    assert_parity(run(soup, (33, 27), "cpu", outputs=outputs), run(soup, (33, 27), "reference", outputs=outputs))


def test_gradients_equal_finite_differences() -> None:
    """Catches an error that the kernel and the reference have in common, and a gradient that is correct only on
    average.
    """
    rng = np.random.default_rng(3)
    soup = random_soup(rng, 12, size=0.6)
    soup = Soup(*(array.double() if array.is_floating_point() else array for array in vars(soup).values()))
    soup.opacity.clamp_(0.1, 0.8)
    soup.sigma.clamp_(0.5, 2)
    camera = turned_camera(12, 10)
    weights = torch.from_numpy(rng.normal(size=(10, 12, 7)))

    def loss(*floats: Tensor) -> Tensor:
        image = splat_triangles(floats[0], soup.tri, *floats[1:], camera, backend="reference")
        assert image.depth is not None
        assert image.normal is not None
        everything = [image.features, image.normal, (image.depth * image.alpha)[..., None]]
        return (torch.cat(everything, dim=-1) * weights).sum() + image.alpha.square().sum()

    free = [array.clone().requires_grad_() for array in soup.floats]
    gradients = torch.autograd.grad(loss(*free), free)
    step = 1e-7
    wrong = []
    for which, gradient in enumerate(gradients):
        for index in range(free[which].numel()):
            with torch.no_grad():
                values = []
                for sign in (-1, 1):
                    moved = [array.clone() for array in free]
                    moved[which].view(-1)[index] += sign * step
                    values.append(float(loss(*moved)))
            difference = (values[1] - values[0]) / (2 * step)
            found = float(gradient.reshape(-1)[index])
            # If a triangle starts or stops hitting a pixel, the loss jumps. No gradient describes this jump.
            if abs(difference - found) > 1e-4 * (1 + abs(found)) and abs(difference) < 1e4:
                wrong.append((NAMES[which], index, found, difference))
    assert not wrong


@pytest.mark.parametrize("simd", SIMD)
def test_instruction_sets_and_threads_give_the_same_bits(simd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches sums whose order depends on the thread or on the width of the vectors."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    soup = random_soup(np.random.default_rng(11), 400)
    wanted = run(soup, (75, 61), "cpu", threads=1)
    monkeypatch.setenv("FOURD_SIMD", simd)
    for threads in (1, 2, 5):
        got = run(soup, (75, 61), "cpu", threads=threads)
        for one, other in zip((*got[0], *got[1]), (*wanted[0], *wanted[1]), strict=True):
            assert torch.equal(one, other)


def test_ties_go_to_the_smaller_index() -> None:
    """Catches an order of triangles with equal depths that depends on the sorting algorithm."""
    corners = torch.tensor([[-1.0, -1.0, 0], [1.0, -1.0, 0], [0.0, 1.5, 0]])
    tri = torch.tensor([[0, 1, 2]] * 3, dtype=torch.int32)
    colours = torch.eye(3)
    image = splat_triangles(corners, tri, colours, torch.full((3,), 0.9), 1e-3, turned_camera(9, 9))
    expected = torch.tensor([0.9, 0.09, 0.009])
    torch.testing.assert_close(image.features[4, 4], expected, atol=1e-3, rtol=0)
    order = torch.tensor([2, 0, 1])
    image = splat_triangles(corners, tri, colours[order], torch.full((3,), 0.9), 1e-3, turned_camera(9, 9))
    torch.testing.assert_close(image.features[4, 4][order], expected, atol=1e-3, rtol=0)


def test_the_nearest_centre_is_in_front() -> None:
    """Catches triangles that are composited in the order of their indices."""
    rng = np.random.default_rng(1)
    depth = torch.from_numpy(rng.permutation(20)).float() / 10
    corners = torch.tensor([[-1.0, -1.0, 0], [1.0, -1.0, 0], [0.0, 1.5, 0]]).repeat(20, 1)
    corners[:, 2] = depth.repeat_interleave(3)
    tri = torch.arange(60, dtype=torch.int32).reshape(20, 3)
    image = splat_triangles(corners, tri, depth[:, None], torch.full((20,), 1.0), 1e-3, turned_camera(9, 9))
    assert float(image.features[4, 4, 0]) < 0.01
    assert float(image.weight[depth.argmin()]) == pytest.approx(0.99, abs=1e-3)


@pytest.mark.parametrize(("count", "size", "layers"), [(150, (41, 35), None), (60, (16, 16), 1), (40, (3, 50), 7)])
def test_cuda_equals_the_reference(count: int, size: tuple[int, int], layers: int | None, gpu: torch.device) -> None:
    """Catches pixels of the wrong tile, a wrong compositing order, errors from diverging warps, and missing terms in
    sums.
    """
    soup = random_soup(np.random.default_rng(count), count)
    got = run(soup, size, "auto", layers=layers, device=gpu)
    assert_parity(got, run(soup, size, "reference", layers=layers))


@pytest.mark.parametrize("channels", [1, 4, 5, 32])
@pytest.mark.parametrize("geometry", [False, True])
def test_cuda_channel_counts(channels: int, geometry: bool, gpu: torch.device) -> None:
    """Catches a wrong stride in the general kernel, and geometry that is written to the features."""
    soup = random_soup(np.random.default_rng(channels), 50, channels)
    outputs = OUTPUTS if geometry else ("features", "alpha")
    got = run(soup, (19, 18), "auto", geometry=geometry, outputs=outputs, device=gpu)
    assert_parity(got, run(soup, (19, 18), "reference", geometry=geometry, outputs=outputs))


def test_cuda_entries_that_do_not_fit(gpu: torch.device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches wrong images where the buffer of (triangle, tile) pairs is too small."""
    soup = random_soup(np.random.default_rng(2), 80)
    expected = run(soup, (41, 35), "reference")
    real = op.gpu._plan

    def small(*arguments: object) -> tuple[object, int, Tensor]:
        estimator, _, memory = real(*arguments)  # type: ignore[arg-type]
        return estimator, 3, memory

    monkeypatch.setattr(op.gpu, "_plan", small)
    assert_parity(run(soup, (41, 35), "auto", device=gpu), expected)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 3e38, -3e38])
@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_invalid_triangles_change_nothing_and_get_no_gradient(bad: float, backend: str) -> None:
    """Catches triangles of NaN depth that are sorted to the front, and NaN gradients of culled triangles."""
    soup = random_soup(np.random.default_rng(4), 100)
    soup = replace(soup, tri=torch.arange(300, dtype=torch.int32).reshape(100, 3))
    clean = run(soup, (40, 30), backend)
    more = replace(
        soup,
        xyz=torch.cat([soup.xyz, torch.full((3, 3), bad), torch.zeros(6, 3)]),
        tri=torch.cat([soup.tri, torch.tensor([[300, 301, 302], [303, 304, 305], [0, 1, 2]], dtype=torch.int32)]),
        features=torch.cat([soup.features, torch.ones(3, 3)]),
        opacity=torch.cat([soup.opacity, torch.tensor([0.5, 0.5, float("nan")])]),
        sigma=torch.cat([soup.sigma, torch.ones(3)]),
    )
    images, gradients = run(more, (40, 30), backend)
    for got, expected in zip(images[:4], clean[0][:4], strict=True):
        assert torch.equal(got, expected)
    assert float(images[4][100:].max()) == 0
    for gradient, expected in zip(gradients, clean[1], strict=True):
        assert torch.equal(gradient[len(expected) :], torch.zeros_like(gradient[len(expected) :]))
        torch.testing.assert_close(gradient[: len(expected)], expected)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_no_triangles(backend: str) -> None:
    """Catches errors if there are no triangles: an empty sort, and images that have no gradient."""
    soup = Soup(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.int32), *(torch.zeros(s) for s in [(0, 3), 0, 0]))
    images, gradients = run(soup, (20, 10), backend)
    assert all(float(image.abs().sum()) == 0 for image in images)
    assert [gradient.shape[0] for gradient in gradients] == [0, 0, 0, 0]


@pytest.mark.parametrize("geometry", [False, True])
def test_opcheck(geometry: bool) -> None:
    """Catches fake shapes, mutations and autograd registrations that torch.compile cannot use."""
    soup = random_soup(np.random.default_rng(0), 20, 7)
    floats = [array.requires_grad_() for array in soup.floats]
    camera = turned_camera(20, 12)
    settings = (geometry, pack_camera(camera), 20, 12, 100, 0.01, 1)
    torch.library.opcheck(op.splat.defined, (floats[0], soup.tri, *floats[1:], *settings))
