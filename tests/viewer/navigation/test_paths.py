"""Camera paths: direction, looping and interpolation."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.viewer.navigation.paths import (
    estimate_focus,
    estimate_up,
    fit_camera,
    interpolate,
    orbit,
    order_by_azimuth,
    spiral,
)
from tests.captures import ring_cameras


@pytest.mark.parametrize("make", [orbit, spiral])
def test_paths_face_the_focus_and_loop(make: Callable[..., list[Camera]]) -> None:
    """Catches a camera path that faces away from the scene, rolls, jumps at its end, or passes through the scene."""
    cameras = ring_cameras(10, 64)
    path = make(cameras, 60, focus=[0.0, 0, 0])
    assert len(path) == 60
    centres = np.array([camera.centre for camera in path])
    steps = np.linalg.norm(np.diff(centres, axis=0, append=centres[:1]), axis=1)
    assert steps.max() < 2.5 * steps.mean()
    for camera in path:
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert np.abs(pixel[0] - 32).max() < 1
        assert 1.5 < depth[0] < 2.8
        assert -camera.rotation[1] @ estimate_up(cameras) > 0.5


def test_interpolation_passes_through_the_cameras() -> None:
    """Catches a spline that does not pass through the cameras of the capture."""
    cameras = ring_cameras(6, 64)
    path = interpolate(cameras, 240)
    centres = np.array([camera.centre for camera in path])
    for camera in cameras:
        assert np.linalg.norm(centres - camera.centre, axis=1).min() < 0.05
    for camera in path:
        assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)


def test_focus_and_order_of_a_ring() -> None:
    """Catches a focus point behind the cameras, and a wrong order of cameras, in which a path zigzags."""
    cameras = ring_cameras(8, 64)
    assert np.abs(estimate_focus(cameras)).max() < 0.05
    order = order_by_azimuth([cameras[index] for index in (3, 0, 6, 1, 7, 2, 5, 4)])
    positions = [(3, 0, 6, 1, 7, 2, 5, 4)[index] for index in order]
    assert {abs(a - b) for a, b in itertools.pairwise(positions)} <= {1, 7}


def test_fit_camera_keeps_the_whole_image() -> None:
    """Catches an image that is stretched or cropped if the aspect ratios of the video and the camera differ."""
    camera = fit_camera(ring_cameras(1, 64)[0], 200, 100)
    assert (camera.width, camera.height) == (200, 100)
    assert camera.intrinsics[0, 0] == camera.intrinsics[1, 1]
    assert camera.intrinsics[0, 2] == pytest.approx(100)


@pytest.mark.parametrize("steps", [0, -3])
def test_wrong_numbers_of_steps(steps: int) -> None:
    with pytest.raises(ValueError, match="steps"):
        orbit(ring_cameras(4, 32), steps)
