"""Camera paths: direction, looping and interpolation."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from fourd.base.cameras import Camera, look_at
from fourd.viewer.navigation.paths import (
    PathKind,
    camera_path,
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


@pytest.mark.parametrize("kind", ["orbit", "spiral"])
def test_a_path_in_a_whole_scene_stays_in_the_room(kind: PathKind) -> None:
    """Catches an orbit through the walls: the median distance of cameras in the corners of a box is larger than the
    distance to its walls. Views from behind a wall were dark."""
    corners = [np.array([x, y, z]) for x in (-3.0, 3.0) for y in (-2.5, 2.5) for z in (-1.5, 1.5)]
    middles = [np.array([x, y, 0.0]) for x, y in ((3.0, 0.5), (-3.0, 0.5), (0.2, 2.5), (0.2, -2.5))]
    intrinsics = np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])
    cameras = [look_at(at, np.zeros(3), np.array([0.0, 0, 1]), intrinsics, 64, 64) for at in corners + middles]
    inside = camera_path(kind, cameras, np.zeros(3), 40, is_whole=True)
    for camera in inside:
        assert (np.abs(camera.centre) < [3.0, 2.5, 1.5]).all()
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert np.abs(pixel[0] - 32).max() < 1e-6
        assert depth[0] > 1.5
    subject = camera_path(kind, cameras, np.zeros(3), 40)
    assert max(abs(camera.centre[1]) for camera in subject) > 2.5


def test_an_orbit_frames_a_small_subject() -> None:
    """On the rig of a laboratory, an orbit kept the distance of the cameras, and the subject was 3% of the images."""
    intrinsics = np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])
    angles = 2 * np.pi * np.arange(8) / 8
    centres = [np.array([9 * np.cos(angle), 9 * np.sin(angle), 2.0]) for angle in angles]
    cameras = [look_at(at, np.zeros(3), np.array([0.0, 0, 1]), intrinsics, 64, 64) for at in centres]
    lower, upper = np.array([0.5, 0.5, -1.0]), np.array([1.0, 1.0, 1.0])
    corners = np.array(list(itertools.product(*zip(lower, upper, strict=True))))
    path = camera_path("orbit", cameras, np.zeros(3), 12, bounds=(lower, upper))
    shares = []
    for camera in path:
        pixels, depths = camera.project(corners)
        assert depths.min() > 0
        shares.append(float(np.abs(pixels - 32).max() / 32))
    assert max(shares) == pytest.approx(0.8, abs=1e-6)
    assert min(shares) > 0.6


def test_an_orbit_around_a_large_subject_keeps_the_distance_of_the_cameras() -> None:
    """Catches images that are magnified although the subject already fills them."""
    cameras = ring_cameras(10, 64)
    box = (np.full(3, -0.8), np.full(3, 0.8))
    framed = camera_path("orbit", cameras, np.zeros(3), 12, bounds=box)
    plain = camera_path("orbit", cameras, np.zeros(3), 12)
    assert all(np.array_equal(a.centre, b.centre) for a, b in zip(framed, plain, strict=True))


def test_a_path_around_a_flat_ring_keeps_its_distance() -> None:
    """Catches an orbit that moves into the subject because the hull of a flat ring of cameras is no room."""
    intrinsics = np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])
    azimuths = np.radians([0.0, 40, 90, 130, 170, 220, 270, 310])
    centres = [
        np.array([3 * np.cos(angle), 3 * np.sin(angle), 0.1 * (-1) ** index]) for index, angle in enumerate(azimuths)
    ]
    cameras = [look_at(at, np.zeros(3), np.array([0.0, 0, 1]), intrinsics, 64, 64) for at in centres]
    whole = camera_path("spiral", cameras, np.zeros(3), 12, is_whole=True)
    plain = camera_path("spiral", cameras, np.zeros(3), 12)
    assert all(np.array_equal(a.centre, b.centre) for a, b in zip(whole, plain, strict=True))


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
