"""The K-Planes kernel compared with plain torch: values, gradients, extreme coordinates, threads and errors."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.planes.op import sample_planes
from fourd.rendering.ops.planes.reference import sample_planes_reference

PAIRS = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))


def random_planes(rng: np.random.Generator, features: int, columns: int = 9) -> tuple[list[Tensor], list[int]]:
    """Return six planes of different sizes, and a seventh plane for a second resolution level."""
    planes = []
    for first, second in (*PAIRS, PAIRS[0]):
        shape = (2 if second == 3 else columns + second, columns + first + len(planes), features)
        planes.append(torch.from_numpy(rng.standard_normal(shape).astype(np.float32)))
    return planes, [axis for pair in (*PAIRS, PAIRS[0]) for axis in pair]


def points(rng: np.random.Generator, count: int = 3000) -> Tensor:
    return torch.from_numpy(rng.uniform(-1.2, 1.2, (count, 4)).astype(np.float32))


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("features", [1, 3, 8, 16])
def test_values_and_gradients_equal_the_reference(
    features: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches swapped rows and columns, swapped corner weights, and coordinate gradients outside the border of a
    plane."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    planes, axes = random_planes(rng, features)
    coordinates = points(rng)
    upstream = torch.from_numpy(rng.standard_normal((len(coordinates), 7 * features)).astype(np.float32))
    results = []
    for function in (sample_planes, sample_planes_reference):
        leaves = [tensor.clone().requires_grad_() for tensor in (coordinates, *planes)]
        out = function(leaves[0], leaves[1:], axes)
        results.append([out, *torch.autograd.grad(out, leaves, upstream)])
    for found, expected in zip(*results, strict=True):
        scale = float(expected.detach().abs().max())
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=2e-6 * scale)


@pytest.mark.parametrize("features", [1, 8])
def test_gpu_equals_the_reference(features: int, gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches planes in the wrong order, and coordinate gradients that are not summed over planes."""
    planes, axes = random_planes(rng, features)
    coordinates = points(rng, 300)
    upstream = torch.from_numpy(rng.standard_normal((300, 7 * features)).astype(np.float32))
    results = []
    for function, device in ((sample_planes, gpu), (sample_planes_reference, torch.device("cpu"))):
        leaves = [tensor.to(device, copy=True).requires_grad_() for tensor in (coordinates, *planes)]
        out = function(leaves[0], leaves[1:], axes)
        found = [out, *torch.autograd.grad(out, leaves, upstream.to(device))]
        results.append([tensor.detach().cpu() for tensor in found])
    for found, expected in zip(*results, strict=True):
        scale = float(expected.abs().max())
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=2e-6 * scale)


def test_gradient_equals_finite_differences(rng: np.random.Generator) -> None:
    """Catches an error that the gradients of the kernel and the gradients of the reference have in common."""
    planes, axes = random_planes(rng, 2, columns=4)
    double = [plane.double() for plane in planes]
    coordinates = points(rng, 5).double()

    def total(at: Tensor) -> Tensor:
        return sample_planes_reference(at, double, axes).sum(1)

    step = 1e-6
    leaf = coordinates.float().requires_grad_()
    (gradient,) = torch.autograd.grad(sample_planes(leaf, planes, axes).sum(), leaf)
    for axis in range(4):
        offset = torch.zeros(4, dtype=torch.float64)
        offset[axis] = step
        slope = (total(coordinates + offset) - total(coordinates - offset)) / (2 * step)
        torch.testing.assert_close(gradient[:, axis].double(), slope, rtol=1e-3, atol=1e-3)


def test_extreme_coordinates_stay_inside_the_planes(rng: np.random.Generator) -> None:
    """Catches reads past the last row of a plane, and NaN that spreads to other points."""
    planes, axes = random_planes(rng, 8)
    values = torch.tensor([-1, 1, np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-42, 0.3])
    coordinates = torch.cartesian_prod(values, values, values, values)
    leaves = [plane.clone().requires_grad_() for plane in planes]
    leaf = coordinates.clone().requires_grad_()
    found = sample_planes(leaf, leaves, axes)
    expected = sample_planes_reference(coordinates.nan_to_num(nan=-1, posinf=1, neginf=-1), planes, axes)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)
    for gradient in torch.autograd.grad(found.sum(), [leaf, *leaves]):
        assert gradient.isfinite().all()


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches threads that add gradients to the same sample of a plane in random order."""
    planes, axes = random_planes(rng, 8)
    coordinates = points(rng, 20000)
    upstream = torch.from_numpy(rng.standard_normal((20000, 56)).astype(np.float32))
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        leaves = [tensor.clone().requires_grad_() for tensor in (coordinates, *planes)]
        out = sample_planes(leaves[0], leaves[1:], axes)
        results.append([out, *torch.autograd.grad(out, leaves, upstream)])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_no_points_give_zero_gradients(rng: np.random.Generator) -> None:
    """Catches gradients that are not initialized if there are no points."""
    planes, axes = random_planes(rng, 8)
    leaves = [plane.clone().requires_grad_() for plane in planes]
    found = sample_planes(torch.zeros(0, 4), leaves, axes)
    assert found.shape == (0, 56)
    assert all(not gradient.any() for gradient in torch.autograd.grad(found.sum(), leaves))


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    planes, axes = random_planes(rng, 3, columns=3)
    leaves = [plane.requires_grad_() for plane in planes]
    torch.library.opcheck(torch.ops.fourd.sample_planes.default, (points(rng, 5).requires_grad_(), leaves, axes))


def test_invalid_arguments_are_named(rng: np.random.Generator) -> None:
    """Catches arguments of wrong shape that reach a kernel. The kernel would read past the end of an array."""
    planes, axes = random_planes(rng, 3)
    good = points(rng, 5)
    with pytest.raises(ValueError, match=r"coordinates: expected shape \(N, 4\), got \(5, 3\)"):
        sample_planes(good[:, :3], planes, axes)
    with pytest.raises(ValueError, match="axes: expected two indices for each of 7 planes, got 2"):
        sample_planes(good, planes, axes[:2])
    with pytest.raises(TypeError, match=r"planes\[6\]: expected float32 or float64 in all tensors, got float64"):
        sample_planes(good, [*planes[:6], planes[6].double()], axes)
    with pytest.raises(ValueError, match=r"planes\[6\]: expected shape .*, got \(1, 4, 3\)"):
        sample_planes(good, [*planes[:6], torch.zeros(1, 4, 3)], axes)
    with pytest.raises(ValueError, match="axes: expected 0 to 3"):
        sample_planes(good, planes, [7, *axes[1:]])
