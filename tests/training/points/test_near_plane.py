"""The near plane: how it is chosen, and that no point is created or moves before it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.base.cameras import Camera, look_at
from fourd.base.errors import UserError
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.near_plane import (
    FALLBACK_SHARE,
    choose_near,
    feature_near,
    is_before_near,
    read_static_near,
    revert_moves_before_near,
    write_static_near,
)

INTRINSICS = np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])


def dome_cameras(count: int = 8, reach: float = 2.6) -> list[Camera]:
    """Cameras on a circle that face its centre."""
    angles = np.arange(count) * 2 * np.pi / count
    centres = reach * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    return [look_at(centre, np.zeros(3), np.array([0.0, 0, 1]), INTRINSICS, 100, 100) for centre in centres]


def ball(centre: tuple[float, float, float], radius: float = 0.2) -> np.ndarray:
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    return np.asarray(centre) + radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_the_subject_decides() -> None:
    """Catches a near plane that ignores the subject's distance, or that cuts off a subject close to one camera."""
    cameras = dome_cameras()
    assert choose_near(cameras, [ball((0, 0, 0))]) == pytest.approx(2.6 / 3, rel=0.02)
    assert choose_near(cameras, [ball((0, 0, 0)), ball((1.6, 0, 0))]) == pytest.approx((1.0 - 0.2) / 2, rel=0.05)


def test_bodies_of_cameras_do_not_count() -> None:
    """Catches a near plane in front of a camera's own body: other cameras see it, but it is not part of the subject."""
    cameras = dome_cameras()
    features = [np.full(100, 2.0) for _ in cameras]
    assert choose_near(cameras, [ball((0, 0, 0))], feature_near(features)) == pytest.approx(2.6 / 3, rel=0.02)


def test_near_static_surfaces_are_kept() -> None:
    """Catches a table close to a camera that disappears because the subject is far away."""
    cameras = dome_cameras()
    depths = [np.full(100, 2.0) for _ in cameras]
    depths[3] = np.concatenate([np.full(10, 0.5), depths[3]])
    assert choose_near(cameras, [ball((0, 0, 0))], feature_near(depths)) == pytest.approx(0.25)
    depths[3] = np.full(10, 0.5)
    assert choose_near(cameras, [ball((0, 0, 0))], feature_near(depths)) > 0.8, "a few features can be wrong matches"


def test_without_any_surface() -> None:
    """Catches a crash on a scene without a subject whose plates share no features."""
    assert choose_near(dome_cameras(), [np.zeros((0, 3))]) == pytest.approx(FALLBACK_SHARE * 2.6)
    assert choose_near(dome_cameras(), []) == pytest.approx(FALLBACK_SHARE * 2.6)


def test_a_hull_that_reaches_a_camera_does_not_remove_the_near_plane() -> None:
    """Catches a near plane at the lens, because an outlier of the hull lies there."""
    cameras = dome_cameras()
    assert choose_near(cameras, [ball((2.55, 0, 0), 0.02), ball((0, 0, 0))]) > 0.04


def test_points_before_the_near_plane() -> None:
    """Catches a wall beside a camera that is removed, and points in front of the lens that are not."""
    cameras = dome_cameras()
    xyz = np.array([[2.5, 0, 0], [2.0, 0, 0], [2.6, 0.3, 0], [2.8, 0, 0], [-2.5, 0, 0]])
    assert is_before_near(xyz, cameras, 0.3).tolist() == [True, False, False, False, True]


def test_moves_before_the_near_plane_are_undone() -> None:
    """Catches points that training moves towards the lens of a view."""
    camera = dome_cameras()[0]
    before = torch.tensor([[2.2, 0, 0], [2.2, 0.1, 0], [1.0, 0, 0]])
    points = FramePoints.initial(before.clone(), torch.full((3,), 0.1), 1.0, explicit_sh=False, rgb=None)
    rows = torch.tensor([0, 1])
    points.parameters["xyz"][:] = torch.tensor([[2.4, 0, 0], [2.0, 0.1, 0], [2.4, 0, 0]])
    revert_moves_before_near(points, rows, before[rows], camera, 0.3)
    torch.testing.assert_close(points.xyz, torch.tensor([[2.2, 0, 0], [2.0, 0.1, 0], [2.4, 0, 0]]))


def test_the_stored_near_plane(tmp_path: Path) -> None:
    """Catches a damaged file that is used in silence."""
    assert read_static_near(tmp_path) is None
    write_static_near(tmp_path, 0.25)
    assert read_static_near(tmp_path) == 0.25
    write_static_near(tmp_path, None)
    assert read_static_near(tmp_path) is None
    (tmp_path / "background" / "near.json").write_text('{"near": -1.0}')
    with pytest.raises(UserError, match=r"near.json: expected .* above 0, got -1.0"):
        read_static_near(tmp_path)
