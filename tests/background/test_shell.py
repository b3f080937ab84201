"""The background shell: its directions, distances, colours and occlusion."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.base.cameras import look_at
from fourd.base.convex_hull import distance_to_hull
from fourd.base.formats.ply import ColouredPoints
from fourd.reconstruction.background.shell import build_shell
from tests.captures import ring_cameras, sphere

CENTRE = np.array([0.3, -0.2, 0.1])
RADIUS = 5.0


def _room(gap_deg: float) -> ColouredPoints:
    """A sphere around CENTRE, red below the horizon and blue above. The sphere has no points in an azimuth range of
    ``gap_deg`` degrees."""
    directions = sphere(90_000)
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    kept = directions[np.abs(azimuth) > gap_deg / 2]
    xyz = (CENTRE + RADIUS * kept).astype(np.float32)
    rgb = np.where(kept[:, 2:] > 0, [[20, 40, 200]], [[200, 40, 20]]).astype(np.uint8)
    return ColouredPoints(xyz, rgb)


@pytest.fixture(scope="module")
def shell() -> ColouredPoints:
    return build_shell(_room(28), ring_cameras(8, 64), CENTRE)


def test_shell_fills_only_the_gap(shell: ColouredPoints) -> None:
    """Catches shell points in known directions, and a missing column where the azimuth wraps around."""
    towards = shell.xyz - CENTRE
    azimuth = np.degrees(np.arctan2(towards[:, 1], towards[:, 0]))
    level = np.abs(towards[:, 2]) < 2
    assert np.abs(azimuth[level]).max() < 17
    filled = np.histogram(azimuth[level], bins=12, range=(-12, 12))[0]
    assert filled.min() > 20


def test_shell_extrapolates_distance_and_colour_along_the_horizon(shell: ColouredPoints) -> None:
    """Catches interpolation of distances instead of inverse distances, and colours that blend vertically."""
    towards = shell.xyz - CENTRE
    np.testing.assert_allclose(np.linalg.norm(towards, axis=1), RADIUS, rtol=0.02)
    near_edge = np.abs(np.degrees(np.arctan2(towards[:, 1], towards[:, 0]))) > 9
    above = near_edge & (towards[:, 2] > 1) & (towards[:, 2] < 4)
    below = near_edge & (towards[:, 2] < -1) & (towards[:, 2] > -4)
    assert np.abs(shell.rgb[above].astype(int) - [20, 40, 200]).max() < 60
    assert np.abs(shell.rgb[below].astype(int) - [200, 40, 20]).max() < 60


def test_a_closed_room_has_no_shell() -> None:
    """Catches a test for gaps that reports gaps in a closed surface, between points at their usual distance."""
    assert len(build_shell(_room(0), ring_cameras(8, 64), CENTRE).xyz) == 0


def test_shell_does_not_occlude_seen_points() -> None:
    """Catches a shell in front of a farther wall that cameras see through the gap."""
    room = _room(50)
    # A far wall that a camera sees through the gap.
    steps = np.linspace(-8, 8, 200)
    y, z = np.meshgrid(steps, steps)
    wall = np.stack([np.full_like(y, 12.0), y, z], axis=-1).reshape(-1, 3)
    azimuth_deg = np.degrees(np.abs(np.arctan2(wall[:, 1] - CENTRE[1], wall[:, 0] - CENTRE[0])))
    wall = wall[azimuth_deg < 12].astype(np.float32)
    points = ColouredPoints(
        np.concatenate([room.xyz, wall]), np.concatenate([room.rgb, np.full(wall.shape, 90, np.uint8)])
    )
    cameras = ring_cameras(8, 64)
    found = build_shell(points, cameras, CENTRE)
    for camera in cameras:
        pixels, depth = camera.project(wall)
        inside = (depth > 0) & (pixels > 4).all(axis=1) & (pixels < 60).all(axis=1)
        if inside.sum() < 2000:
            continue
        mine, my_depth = camera.project(found.xyz)
        low, high = pixels[inside].min(axis=0) + 4, pixels[inside].max(axis=0) - 4
        over = (my_depth > 0) & (mine > low).all(axis=1) & (mine < high).all(axis=1)
        assert (my_depth[over] > 0.85 * np.median(depth[inside])).all()


def test_no_points_give_no_shell() -> None:
    """Catches a crash of the interpolation if no direction is known."""
    empty = ColouredPoints(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    assert len(build_shell(empty, ring_cameras(8, 64), CENTRE).xyz) == 0


def test_a_shell_stays_behind_cameras_in_the_walls() -> None:
    """Catches an unseen ceiling that hangs before the cameras in it, and one that is left out because it is nearer than
    the walls: cameras on a dome saw each other through it."""
    directions = sphere(90_000)
    directions = directions[directions[:, 2] < 0.6]
    walls = 3.0 * directions
    intrinsics = np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])
    cameras = [look_at(2.8 * each, np.zeros(3), np.array([0.0, 0, 1]), intrinsics, 64, 64) for each in sphere(60)]
    grey = np.full((len(walls), 3), 128, np.uint8)
    # The known ceiling ends in points that are too near, from which the distance of the rest would be extrapolated.
    walls[directions[:, 2] > 0.45] *= 0.6
    shell = build_shell(ColouredPoints(walls.astype(np.float32), grey), cameras, np.zeros(3))
    distance = np.linalg.norm(shell.xyz, axis=1)
    up = shell.xyz[:, 2] / distance > 0.75
    assert up.sum() > 20
    assert distance[up].min() > 2.4


def test_the_distance_to_the_hull_of_a_cube_is_known() -> None:
    """Catches distances from the wrong side of a hull, and an error for cameras in a plane or beside the scene."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    directions = np.array([[1.0, 0, 0], [0, 0, -1], np.array([1.0, 1, 0]) / np.sqrt(2)])
    assert np.allclose(distance_to_hull(directions, corners, np.zeros(3)), [1, 1, np.sqrt(2)])
    assert np.allclose(distance_to_hull(directions, corners, np.array([0.5, 0, 0])), [0.5, 1, np.sqrt(0.5)])
    assert not distance_to_hull(directions, corners, np.array([3.0, 0, 0])).any()
    assert not distance_to_hull(directions, corners[corners[:, 2] > 0], np.zeros(3)).any()
