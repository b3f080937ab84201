"""Shadows on the floor: the plane on which they lie, and the light that all cameras agree on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.recording.matting.motion.agreement import VoxelGrid
from fourd.recording.matting.motion.background_model import BackgroundModel
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.evidence import Appearance
from fourd.recording.matting.shadows.floor import Floor, find_floor, shaded_points
from fourd.recording.matting.shadows.floor_light import FloorGrid

Floats = NDArray[np.float32]

SIDE = 96
SHADOW_LIGHT = 0.6
SHADOW_RADIUS = 0.6
BALL_RADIUS = 0.35
BALL_CENTRE = np.array([0.0, 0.0, 0.6])
BOX = np.array([[-0.7, -0.7, -0.05], [0.7, 0.7, 1.0]])


@dataclass(frozen=True)
class View:
    """A grey ball above a grey floor, and its soft shadow.

    Attributes:
        camera: the camera.
        plate: (h, w, 3) image without the ball and its shadow.
        rgb: (h, w, 3) image.
        ball: (h, w) bool, true where the image shows the ball.
        shadow: (h, w) bool, true where the image shows the floor in shadow.
    """

    camera: Camera
    plate: Floats
    rgb: NDArray[np.uint8]
    ball: NDArray[np.bool_]
    shadow: NDArray[np.bool_]

    @property
    def background(self) -> BackgroundModel:
        height, width = self.ball.shape
        return BackgroundModel(
            self.plate, np.full((height, width, 3), 9, np.float32), np.full((height, width), 10, np.float32)
        )


def _view(azimuth_deg: float, height: float, rng: np.random.Generator, has_shadow: bool = True) -> View:
    azimuth = np.radians(azimuth_deg)
    centre = np.array([3 * np.cos(azimuth), 3 * np.sin(azimuth), height])
    intrinsics = np.array([[100.0, 0, SIDE / 2], [0, 100, SIDE / 2], [0, 0, 1]])
    camera = look_at(centre, np.array([0, 0, 0.4]), np.array([0.0, 0, 1]), intrinsics, SIDE, SIDE)
    rows, columns = np.mgrid[:SIDE, :SIDE]
    pixels = np.column_stack([columns.ravel() + 0.5, rows.ravel() + 0.5])
    rays = camera.unproject(pixels, np.ones(len(pixels))) - centre
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    to_floor = np.where(rays[:, 2] < -1e-6, -centre[2] / np.minimum(rays[:, 2], -1e-6), np.inf)
    place = centre + np.minimum(to_floor, 50)[:, None] * rays
    is_floor = np.isfinite(to_floor) & (np.hypot(place[:, 0], place[:, 1]) < 4)
    plate = np.where(is_floor, 130.0, 200.0 - 20 * np.sin(3 * azimuth))
    light = np.where(is_floor & (np.hypot(place[:, 0], place[:, 1]) < SHADOW_RADIUS), SHADOW_LIGHT, 1.0)
    light = light if has_shadow else np.ones_like(light)
    offset = centre - BALL_CENTRE
    middle = rays @ offset
    ball = middle**2 - offset @ offset + BALL_RADIUS**2 > 0
    # The ball is as grey as the floor in its shadow.
    value = np.where(ball, SHADOW_LIGHT * 130.0, plate * light)
    value = value[:, None] * np.array([1.0, 0.95, 0.9]) + rng.normal(0, 2, (len(value), 3))
    rgb = np.clip(np.rint(value), 0, 255).astype(np.uint8).reshape(SIDE, SIDE, 3)
    colours = (plate[:, None] * np.array([1.0, 0.95, 0.9])).astype(np.float32).reshape(SIDE, SIDE, 3)
    shadow = (light < 1) & ~ball
    return View(camera, colours, rgb, ball.reshape(SIDE, SIDE), shadow.reshape(SIDE, SIDE))


def _views(has_shadow: bool = True) -> list[View]:
    rng = np.random.default_rng(4)
    return [_view(30 * index, 1.2 + 0.5 * (index % 3), rng, has_shadow) for index in range(12)]


def _shaded(views: list[View]) -> tuple[NDArray[np.float64], VoxelGrid]:
    grid = VoxelGrid.covering(*BOX, [view.camera for view in views])
    observed = [view.background.observed_light(view.rgb) for view in views]
    return shaded_points(grid.xyz, grid.pixels, observed), grid


def test_the_floor_is_found_by_the_shadow() -> None:
    """Catches a floor that is found only where it has texture: stereo finds nothing on a plain grey floor."""
    views = _views()
    points, grid = _shaded(views)
    floor = find_floor(points, [view.camera for view in views], BOX, grid.size, np.random.default_rng(0))
    assert floor is not None
    assert floor.normal[2] > np.cos(np.radians(3))
    assert abs(floor.offset) < 1.5 * grid.size


def test_without_a_shadow_there_is_no_floor() -> None:
    """Catches a floor through the subject: a ball that has the colour of shaded floor is no shadow, because the cameras
    see other backgrounds behind it."""
    views = _views(has_shadow=False)
    points, grid = _shaded(views)
    assert find_floor(points, [view.camera for view in views], BOX, grid.size, np.random.default_rng(0)) is None


@pytest.mark.parametrize("height", [0.5, 1.8])
def test_a_plane_through_the_subject_or_between_the_cameras_is_no_floor(height: float) -> None:
    """Catches the removal of a part of the subject whose points look like shadows by accident."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (300, 2)), np.full(300, height)])
    cameras = [view.camera for view in _views()]
    assert find_floor(points, cameras, BOX, 0.02, rng) is None


def test_the_shadow_is_background_and_the_equally_grey_ball_is_not() -> None:
    """Catches shadows around feet in the mattes, and grey clothes that are taken for shadow."""
    views = _views()
    grid = FloorGrid.covering(Floor(np.array([0.0, 0, 1]), 0.0), BOX, 0.03, [view.camera for view in views])
    lights = grid.light([view.background.observed_light(view.rgb) for view in views])
    subject = ColourHistogram.from_colours(np.concatenate([view.rgb[view.ball] for view in views]))
    surround = ColourHistogram.from_colours(np.concatenate([view.rgb[~view.ball & ~view.shadow] for view in views]))
    in_shadow, before, on_ball = [], [], []
    for view, light in zip(views, lights, strict=True):
        everywhere = np.ones(view.ball.shape, np.bool_)
        appearance = Appearance(view.background, subject, surround, everywhere, 1.0)
        odds = appearance.log_odds(view.rgb, None, light)
        in_shadow.append(odds[view.shadow])
        before.append(appearance.log_odds(view.rgb, None)[view.shadow])
        on_ball.append(odds[view.ball])
        visible = light.probability[view.shadow] > 0.5
        assert np.median(np.abs(light.light[view.shadow][visible] - SHADOW_LIGHT)) < 0.03
    shadow, plain, ball = (np.concatenate(each) for each in (in_shadow, before, on_ball))
    assert np.mean(shadow < plain - 1) > 0.75
    # The cameras whose line of sight through the ball ends in the shadow cannot tell, and the hull decides.
    assert np.mean(ball > 0) > 0.6


def test_cameras_above_and_below_the_horizon_and_few_cameras() -> None:
    """Catches a floor that appears above the horizon, and the light of two cameras alone."""
    views = _views()[:3]
    grid = FloorGrid.covering(Floor(np.array([0.0, 0, 1]), 0.0), BOX, 0.05, [view.camera for view in views])
    lights = grid.light([view.background.observed_light(view.rgb) for view in views])
    assert all(not light.probability.any() for light in lights)
    low = _view(10, 0.45, np.random.default_rng(0))
    many = [*_views(), low]
    grid = FloorGrid.covering(Floor(np.array([0.0, 0, 1]), 0.0), BOX, 0.05, [view.camera for view in many])
    light = grid.light([view.background.observed_light(view.rgb) for view in many])[-1]
    rows, columns = np.nonzero(light.probability > 0)
    rays = low.camera.unproject(np.column_stack([columns + 0.5, rows + 0.5]), np.ones(len(rows))) - low.camera.centre
    assert len(rows)
    assert (rays[:, 2] < 0).all()
