"""Smoothing of the surface that a frame's points sample."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.smoothing import (
    NEIGHBOURS,
    REFIT_STEPS,
    TOLERANCE,
    fit_planes,
    smooth_surface,
)

COUNT = 2000
SPACING = float(np.sqrt(4 * np.pi / COUNT))


def sphere(rng: np.random.Generator, noise: float) -> Tensor:
    """Points spread evenly over the unit sphere (a Fibonacci lattice), moved radially by ``noise`` spacings."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(COUNT)
    z = 1 - 2 * (np.arange(COUNT) + 0.5) / COUNT
    ring = np.sqrt(1 - z**2)
    unit = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
    return torch.from_numpy((unit * (1 + noise * SPACING * rng.normal(size=(COUNT, 1)))).astype(np.float32))


def cloud(xyz: Tensor) -> FramePoints:
    return FramePoints.initial(xyz, torch.full((len(xyz),), SPACING), 1.3, explicit_sh=False)


def smooth(points: FramePoints, rate_spacings: float, steps: int) -> None:
    rows = torch.arange(len(points.xyz))
    for _ in range(steps):
        smooth_surface(points, rows, torch.full((len(rows), 1), rate_spacings * SPACING), 0.5)
        points.age += 1


def test_planes_through_points_of_a_plane_are_exact(rng: np.random.Generator) -> None:
    """Catches plane offsets that do not belong to the normals, and planes that ignore the position of the cloud."""
    normal = torch.nn.functional.normalize(torch.tensor([1.0, -2.0, 0.5]), dim=0)
    xyz = torch.from_numpy(rng.normal(size=(300, 3)).astype(np.float32))
    xyz = xyz - ((xyz @ normal) - 3.0)[:, None] * normal
    planes = fit_planes(xyz).planes
    torch.testing.assert_close((planes[:, :3] @ normal).abs(), torch.ones(300), rtol=0, atol=1e-4)
    torch.testing.assert_close((planes[:, :3] * xyz).sum(1), planes[:, 3], rtol=0, atol=1e-4)


def test_noise_across_the_surface_is_removed_up_to_the_tolerance(rng: np.random.Generator) -> None:
    """Catches smoothing that moves points in the wrong direction, and smoothing that shrinks a curved surface."""
    points = cloud(sphere(rng, noise=0.6))
    noise = (points.xyz.norm(dim=1) - 1) / SPACING
    smooth(points, rate_spacings=0.3, steps=60)
    height = (points.xyz.norm(dim=1) - 1) / SPACING
    assert float(height.std()) < 0.75 * 0.6
    assert abs(float(height.mean() - noise.mean())) < 0.1
    assert float(height.abs().quantile(0.98)) < 0.6 * 2.3


def test_points_within_the_tolerance_stay(rng: np.random.Generator) -> None:
    """Catches smoothing of details that the images determine."""
    points = cloud(sphere(rng, noise=0.0))
    before = points.xyz.clone()
    smooth(points, rate_spacings=0.3, steps=5)
    assert torch.equal(points.xyz, before)
    assert TOLERANCE > 0


def test_only_the_given_points_move(rng: np.random.Generator) -> None:
    """Catches smoothing that moves points that are not visible in the step."""
    points = cloud(sphere(rng, noise=0.6))
    before = points.xyz.clone()
    rows = torch.arange(0, COUNT, 3)
    smooth_surface(points, rows, torch.full((len(rows), 1), 0.3 * SPACING), 0.5)
    moved = (points.xyz != before).any(dim=1)
    assert moved[rows].float().mean() > 0.3
    moved[rows] = False
    assert not moved.any()


@pytest.mark.parametrize("saved", [False, True])
def test_planes_are_fitted_again_after_some_steps(saved: bool, rng: np.random.Generator) -> None:
    """Catches planes that a resumed run and an uninterrupted run fit at different steps."""
    points = cloud(sphere(rng, noise=0.6))
    smooth(points, rate_spacings=0.3, steps=REFIT_STEPS // 2)
    first = points.local_planes
    assert first is not None
    if saved:
        points = FramePoints.from_tensors(points.tensors())
    smooth(points, rate_spacings=0.3, steps=REFIT_STEPS - REFIT_STEPS // 2)
    assert points.local_planes is not None
    assert torch.equal(points.local_planes, first)
    smooth(points, rate_spacings=0.3, steps=1)
    assert not torch.equal(points.local_planes, first)


def test_planes_are_dropped_if_points_are_added_or_removed(rng: np.random.Generator) -> None:
    """Catches planes that belong to other points after densification."""
    points = cloud(sphere(rng, noise=0.6))
    smooth(points, rate_spacings=0.3, steps=1)
    points.keep_and_insert(torch.arange(10, COUNT))
    assert points.local_planes is None
    smooth(points, rate_spacings=0.3, steps=1)


def test_a_cloud_with_few_points_is_not_smoothed(rng: np.random.Generator) -> None:
    """Catches a search for more neighbours than the cloud has points."""
    points = cloud(sphere(rng, noise=0.6)[: NEIGHBOURS - 1])
    before = points.xyz.clone()
    smooth(points, rate_spacings=0.3, steps=1)
    assert torch.equal(points.xyz, before)


def test_isolated_points_return_to_the_surface(rng: np.random.Generator) -> None:
    """Catches specks beside the subject, which are points that training moved away from the surface and cannot move
    back."""
    xyz = sphere(rng, noise=0.2)
    xyz[[5, 700]] *= 1.4
    points = cloud(xyz)
    smooth_surface(points, torch.tensor([0]), torch.zeros(1, 1), 0.5)
    assert float((points.xyz[[5, 700]].norm(dim=1) - 1).abs().max()) < 2 * SPACING
    others = torch.ones(COUNT, dtype=torch.bool)
    others[[5, 700]] = False
    assert torch.equal(points.xyz[others], xyz[others])
