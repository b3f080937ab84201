"""The kernels that update points compared with the same updates in plain torch, which float64 tensors use."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.training.points.dense_adam import DenseAdam
from fourd.reconstruction.training.points.densification import accumulate_gradient_magnitudes
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.near_plane import revert_moves_before_near
from fourd.reconstruction.training.points.silhouette import revert_moves_out_of_silhouettes
from fourd.reconstruction.training.points.smoothing import fit_planes, smooth_surface
from fourd.rendering.ops.moves import has_kernels

COUNT = 3001
CAMERA = Camera(np.array([[20.0, 0, 12], [0, 20, 10], [0, 0, 1]]), np.eye(3), np.array([0.0, 0, 3]), 24, 20)
Update = Callable[[FramePoints, Tensor, Tensor, Tensor], object]


def make_points(rng: np.random.Generator) -> FramePoints:
    xyz = torch.from_numpy(rng.uniform(-1, 1, (COUNT, 3)).astype(np.float32))
    rgb = torch.from_numpy(rng.uniform(0, 1, (COUNT, 3)).astype(np.float32))
    points = FramePoints.initial(xyz, torch.full((COUNT,), 0.05), 1.3, explicit_sh=False, rgb=rgb)
    points.local_planes = fit_planes(xyz).planes
    points.age += 1
    return points


def as_double(points: FramePoints) -> FramePoints:
    return FramePoints.from_tensors({name: value.double() for name, value in points.tensors().items()})


def adam(points: FramePoints, rows: Tensor, before: Tensor, gradient: Tensor) -> None:
    rates = {"xyz": 0.01 * points.spacing[rows][:, None], "rgb": 0.005}
    for _ in range(3):
        points.optimizer.step(points.parameters, rows, {"xyz": gradient, "rgb": 2 * gradient}, rates)


def smooth(points: FramePoints, rows: Tensor, before: Tensor, gradient: Tensor) -> None:
    smooth_surface(points, rows, 0.6 * points.spacing[rows][:, None], 0.5)


def magnitudes(points: FramePoints, rows: Tensor, before: Tensor, gradient: Tensor) -> None:
    accumulate_gradient_magnitudes(points, rows, gradient)


def silhouettes(points: FramePoints, rows: Tensor, before: Tensor, gradient: Tensor) -> None:
    matte = torch.zeros(1, 20, 24, dtype=before.dtype)
    matte[:, 4:15, 6:17] = 1
    revert_moves_out_of_silhouettes(points, rows, before, [((CAMERA,), matte)])


def near(points: FramePoints, rows: Tensor, before: Tensor, gradient: Tensor) -> None:
    revert_moves_before_near(points, rows, before, CAMERA, 2.6)


@pytest.mark.parametrize("update", [adam, smooth, magnitudes, silhouettes, near])
def test_kernels_equal_plain_torch(update: Update, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a kernel that updates other rows than torch, or by another formula, and a thread count that changes the
    result."""
    rows = torch.from_numpy(np.sort(rng.choice(COUNT, 2500, replace=False)))
    before = torch.from_numpy(rng.uniform(-1, 1, (2500, 3)).astype(np.float32))
    gradient = torch.from_numpy(rng.standard_normal((2500, 3)).astype(np.float32))
    gradient[::7] = 0
    gradient[5, 1] = torch.nan
    start = make_points(rng)
    exact = as_double(start)
    update(exact, rows, before.double(), gradient.double())
    results = []
    for threads in ("1", "3"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        points = FramePoints.from_tensors({name: value.clone() for name, value in start.tensors().items()})
        update(points, rows, before, gradient)
        results.append(points.tensors())
    changed = [name for name, value in start.tensors().items() if not torch.equal(value, results[0][name])]
    assert set(changed) - {"age"}, "the update changed nothing"
    for name, other in exact.tensors().items():
        assert torch.equal(results[0][name], results[1][name])
        error = (results[0][name].double() - other.double()).abs()
        # Rounding may decide differently for a point on the border of a silhouette.
        assert float((error > 1e-5).float().mean()) <= 1e-3, name


def test_dense_adam_equals_torch_adam(rng: np.random.Generator) -> None:
    """Catches a wrong bias correction, a parameter whose gradient has another memory format, parameters without a
    gradient that are updated or counted, and arrays of a state that has been replaced."""

    def parameters() -> list[torch.nn.Parameter]:
        generator = torch.Generator().manual_seed(0)
        return [
            torch.nn.Parameter(torch.randn(shape, generator=generator)) for shape in ((70, 300), (8, 4, 3, 3), (1,))
        ]

    ours, theirs = parameters(), parameters()
    options = {"lr": 0.01, "betas": (0.9, 0.99), "eps": 1e-15}
    optimizers = DenseAdam(ours, **options), torch.optim.Adam(theirs, **options)  # type: ignore[arg-type]
    for number in range(8):
        if number == 5:
            optimizers[0].load_state_dict(copy.deepcopy(optimizers[0].state_dict()))
        for one, other in zip(ours, theirs, strict=True):
            gradient = torch.from_numpy(rng.standard_normal(one.shape).astype(np.float32))
            if gradient.ndim == 4:
                gradient = gradient.contiguous(memory_format=torch.channels_last)
            skips = number == 2 and one.numel() == 1
            one.grad, other.grad = (None, None) if skips else (gradient, gradient)
        for optimizer in optimizers:
            optimizer.step()
    assert has_kernels(*ours)
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)
        assert optimizers[0].state[one]["step"] == optimizers[1].state[other]["step"]
    optimizers[1].load_state_dict(optimizers[0].state_dict())
