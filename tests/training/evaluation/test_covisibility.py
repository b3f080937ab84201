"""Pixels of held-out views whose surface is visible in a training view, on planes with known depths."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.reconstruction.training.evaluation.covisibility import covisible_psnr, visible_in_any

SIZE = 8
WALL = 4.0
"""Depth of a wall that is parallel to all images, in world units."""


def camera(x: float) -> Camera:
    """A camera at (x, 0, 0) that looks along +z. A pixel of the wall is 1 world unit wide."""
    intrinsics = np.array([[WALL, 0, SIZE / 2], [0, WALL, SIZE / 2], [0, 0, 1]])
    return Camera(intrinsics, np.eye(3), np.array([-x, 0.0, 0.0]), SIZE, SIZE)


def wall(depth: float = WALL) -> np.ndarray:
    return np.full((SIZE, SIZE), depth, np.float32)


@pytest.mark.parametrize(
    ("x", "visible"), [(0.0, slice(0, 8)), (3.0, slice(3, 8)), (-2.0, slice(0, 6)), (9.0, slice(0, 0))]
)
def test_surfaces_outside_the_training_image_are_not_visible(x: float, visible: slice) -> None:
    """Catches swapped axes, a wrong sign of the translation, and a shift by half a pixel."""
    expected = np.zeros((SIZE, SIZE), bool)
    expected[:, visible] = True
    assert (visible_in_any(camera(0.0), wall(), [camera(x)], [wall()]) == expected).all()


def test_surfaces_behind_other_surfaces_are_not_visible() -> None:
    """Catches a mask that ignores occlusion in the training view."""
    nearest = wall()
    nearest[2:5, 1:3] = 1.0
    assert (visible_in_any(camera(0.0), wall(), [camera(0.0)], [nearest]) == (nearest == WALL)).all()
    assert visible_in_any(camera(0.0), wall(), [camera(0.0)] * 2, [nearest, wall()]).all()


def test_small_differences_of_depth_do_not_hide_a_surface() -> None:
    """Catches a comparison without tolerance, because rendered depths differ between views."""
    assert visible_in_any(camera(0.0), wall(WALL * 1.02), [camera(0.0)], [wall()]).all()
    assert not visible_in_any(camera(0.0), wall(WALL * 1.04), [camera(0.0)], [wall()]).any()


def test_transparent_pixels_are_not_visible() -> None:
    """Catches pixels without depth that count as points at the camera's centre."""
    depth = wall()
    depth[3] = 0.0
    assert (visible_in_any(camera(0.0), depth, [camera(0.0)], [wall()]) == (depth > 0)).all()


def test_psnr_counts_visible_pixels_and_the_subject() -> None:
    """Catches errors at invisible pixels that change the score, and a subject that is left out."""
    truth, picture = np.zeros((SIZE, SIZE, 3), np.float32), np.zeros((SIZE, SIZE, 3), np.float32)
    matte, visible = np.zeros((SIZE, SIZE), np.uint8), np.zeros((SIZE, SIZE), bool)
    visible[:4] = True
    picture[:4] = 0.1
    picture[4:] = 1.0
    assert covisible_psnr(picture, truth, matte, visible) == pytest.approx(20.0, abs=1e-4)
    matte[4:] = 255
    assert covisible_psnr(picture, truth, matte, visible) == pytest.approx(-10 * np.log10((0.01 + 1) / 2), abs=1e-4)
    assert covisible_psnr(picture, truth, matte * 0, visible & False) is None
