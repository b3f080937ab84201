"""Loss term for an opaque background at viewpoints between the cameras."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.base.cameras import look_at
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.losses.background_opacity import (
    MAX_LATERAL_OFFSET,
    interpolate_viewpoint,
    mean_squared_transmittance,
)
from fourd.reconstruction.training.points.frame_points import FramePoints
from tests.captures import ring_cameras
from tests.training.small import full_config, trained_run

INTRINSICS = np.array([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]])
"""Intrinsics of a camera with images of 64 x 64 pixels."""


@pytest.fixture(scope="module")
def background(ball_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> StaticBackground:
    folder = tmp_path_factory.mktemp("opacity")
    run = trained_run(ball_capture, folder / "run", replace(full_config(folder / "shell.ply"), max_steps=1))
    found = run.background(None)
    assert found is not None
    return found


def test_viewpoints_lie_between_the_cameras(rng: np.random.Generator) -> None:
    """Catches viewpoints that are outside the ring of cameras or all equal, and crops that are larger than the
    image."""
    cameras = ring_cameras(8, 64)
    farthest = max(float(np.linalg.norm(camera.centre)) for camera in cameras)
    viewers = [interpolate_viewpoint(cameras[k % 8], cameras, 48, rng) for k in range(200)]
    centres = np.array([viewer.centre for viewer in viewers])
    assert np.linalg.norm(centres, axis=1).max() < (1 + 2 * MAX_LATERAL_OFFSET) * farthest
    assert (centres.std(axis=0)[:2] > 0.2 * farthest).all()
    assert {(viewer.width, viewer.height) for viewer in viewers} == {(48, 48)}
    assert (interpolate_viewpoint(cameras[0], cameras, 500, rng).width, cameras[0].width) == (64, 64)
    for k, viewer in enumerate(viewers):
        np.testing.assert_array_equal(viewer.rotation, cameras[k % 8].rotation)


def test_the_gradient_on_a_floor_of_many_layers_has_the_right_sign(background: StaticBackground) -> None:
    """Catches a gradient that is computed with too few depth layers. It would then enlarge the discs, so that even more
    discs overlap.
    """
    x, y = torch.meshgrid(torch.arange(-2, 2, 0.05), torch.arange(-2, 2, 0.05), indexing="ij")
    floor = torch.stack([x, y, torch.full_like(x, -0.5)], -1).reshape(-1, 3)
    points = FramePoints.initial(floor, torch.full((len(floor),), 0.1), 1.0, explicit_sh=False)
    dense = StaticBackground(background.model, points, background.plates, background.near)
    viewer = look_at(np.array([3.0, 0, 0.2]), np.zeros(3), np.array([0.0, 0, 1]), INTRINSICS, 64, 64)
    radius_bias = dense.model.geometry_head.layers[-1].bias
    gradient = torch.autograd.grad(mean_squared_transmittance(dense, viewer, 0.0), radius_bias)[0][0]
    with torch.no_grad():
        radius_bias[0] += 0.05
        larger = mean_squared_transmittance(dense, viewer, 0.0)
        radius_bias[0] -= 0.1
        smaller = mean_squared_transmittance(dense, viewer, 0.0)
        radius_bias[0] += 0.05
    assert float(gradient) == pytest.approx(float(larger - smaller) / 0.1, rel=0.2, abs=1e-4)


def test_a_wall_with_holes_becomes_opaque(background: StaticBackground) -> None:
    """Catches an opacity loss term without a gradient for the radii of points."""
    y, z = torch.meshgrid(torch.arange(-2, 2, 0.1), torch.arange(-2, 2, 0.1), indexing="ij")
    wall = torch.stack([torch.full_like(y, -1.0), y, z], -1).reshape(-1, 3)
    # The given spacing is half of the true spacing, so that the initial radii are too small.
    points = FramePoints.initial(wall, torch.full((len(wall),), 0.05), 1.0, explicit_sh=False)
    holed = StaticBackground(background.model, points, background.plates, background.near)
    viewer = ring_cameras(8, 64)[0]
    optimizer = torch.optim.Adam(holed.model.parameters(), lr=0.01)
    values = []
    for _ in range(60):
        loss = mean_squared_transmittance(holed, viewer, 0.0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        values.append(float(loss.detach()))
    assert values[0] > 0.05
    assert values[-1] < 0.2 * values[0]
