"""Removal of protruding parts of the visual hull."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from fourd.reconstruction.carving.bounds import Bounds
from fourd.reconstruction.carving.carve import carve_frame
from fourd.reconstruction.carving.excess import _import_trimesh, fill_hull, remove_excess
from fourd.reconstruction.carving.hull import Silhouettes
from tests.captures import ring_cameras
from tests.carving.shapes import ball, mask

BOX = Bounds(np.full(3, -0.7), np.full(3, 0.7))
BALLS = [ball((-0.28, 0.0, 0.0), 0.2), ball((0.28, 0.05, 0.1), 0.16), ball((0.0, 0.3, -0.1), 0.14)]


@pytest.fixture(scope="module")
def views() -> Silhouettes:
    """Three balls that occlude each other in five views. The visual hull has parts that belong to no ball."""
    cameras = ring_cameras(5, 128)
    masks = [mask(camera, BALLS) for camera in cameras]
    return Silhouettes.from_masks(masks, cameras, np.zeros(3), agreement=0.95, least_views=0.5)


def distance_to_balls(xyz: np.ndarray) -> np.ndarray:
    centres, radii = np.array([[-0.28, 0, 0], [0.28, 0.05, 0.1], [0, 0.3, -0.1]]), np.array([0.2, 0.16, 0.14])
    return (np.linalg.norm(xyz[:, None] - centres, axis=2) - radii).min(axis=1)


def test_excess_is_removed_and_the_object_is_kept(views: Silhouettes) -> None:
    """Catches a removal that leaves small pieces of the excess parts, and a removal that takes more of the object than
    the cells at its surface."""
    hull = fill_hull(views, BOX.lower, BOX.upper, 0.01)
    remaining = remove_excess(views, hull)
    before, after = (distance_to_balls(hull.centres(cells)) for cells in (hull.cells, remaining))
    assert (after > 0.01).sum() < 0.1 * (before > 0.01).sum()
    assert (after < -0.04).sum() == (before < -0.04).sum()


def test_every_silhouette_is_still_covered(views: Silhouettes) -> None:
    """Catches a hull that no longer covers a silhouette after excess parts were removed. Only pixels at the contour may
    become uncovered.
    """
    hull = fill_hull(views, BOX.lower, BOX.upper, 0.02)
    remaining = remove_excess(views, hull)
    for view in views.views:
        covered = np.zeros((2, *view.distance.shape), np.bool_)
        for flags, cells in zip(covered, (hull.cells, remaining), strict=True):
            x, y, _ = view.project(np.ascontiguousarray(hull.centres(cells).T))
            for dx, dy in np.ndindex(5, 5):
                columns, rows = x.astype(int) + dx - 2, y.astype(int) + dy - 2
                is_inside = (columns >= 0) & (rows >= 0) & (columns < flags.shape[1]) & (rows < flags.shape[0])
                flags[rows[is_inside], columns[is_inside]] = True
        assert not (covered[0] & ~covered[1] & (view.distance > 1)).any()


def test_the_grid_is_limited(views: Silhouettes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a grid that fills the memory for a small object in a large room."""
    monkeypatch.setattr("fourd.reconstruction.carving.excess.MAX_GRID_CELLS", 100_000)
    hull = fill_hull(views, BOX.lower, BOX.upper, 0.001)
    assert hull.side > 0.01
    assert len(hull.cells) > 0
    assert np.prod(hull.shape) < 400_000


def test_a_ball_keeps_its_points() -> None:
    """Catches new points inside an object that has no excess parts. Also catches an uneven density where old and new
    points meet."""
    cameras = ring_cameras(20, 128)
    masks = [mask(camera, [ball((0.1, -0.05, 0.02), 0.35)]) for camera in cameras]
    carved = carve_frame(masks, cameras, BOX, points=4000)
    distance = np.linalg.norm(carved.xyz - (0.1, -0.05, 0.02), axis=1)
    assert len(carved.xyz) == 4000
    assert distance.min() > 0.33
    np.testing.assert_allclose(np.linalg.norm(carved.normals, axis=1), 1, atol=1e-3)


def test_trimming_can_be_switched_off() -> None:
    """Catches an option that is ignored. Without trimming, points must cover the whole hull."""
    cameras = ring_cameras(5, 96)
    masks = [mask(camera, BALLS) for camera in cameras]
    whole, trimmed = (carve_frame(masks, cameras, BOX, points=3000, trim=trim) for trim in (False, True))
    assert (distance_to_balls(trimmed.xyz) > 0.05).mean() < 0.8 * (distance_to_balls(whole.xyz) > 0.05).mean()


def test_ctrl_c_during_an_import_is_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a Ctrl-C that trimesh swallows, because it catches every exception of its own imports; the command then
    ended with a traceback of trimesh."""
    careless = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
except BaseException:
    lost = True
"""
    (tmp_path / "trimesh.py").write_text(careless)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "trimesh", raising=False)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            _import_trimesh()
        assert not hasattr(sys.modules.pop("trimesh"), "lost")
    finally:
        signal.signal(signal.SIGINT, before)
