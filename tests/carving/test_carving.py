"""Carving of shapes with known visual hulls."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fourd.base.errors import UserError
from fourd.base.formats.ply import read_ply
from fourd.reconstruction.carving import (
    Bounds,
    carve_capture,
    carve_frame,
    colour_points,
    find_bounds,
    hull_bounds,
    sequence,
)
from fourd.reconstruction.carving.hull import Silhouettes
from fourd.reconstruction.carving.surface import surface_cells
from tests.captures import ring_cameras
from tests.carving.shapes import MemoryCapture, ball, mask, moving_ball

CENTRE = np.array([0.1, -0.05, 0.02])
RADIUS = 0.35


@pytest.fixture(scope="module")
def one_ball() -> MemoryCapture:
    cameras = tuple(ring_cameras(20, 128))
    return MemoryCapture(cameras, [[mask(camera, [ball(tuple(CENTRE), RADIUS)]) for camera in cameras]])


def box() -> Bounds:
    return Bounds(np.full(3, -0.7), np.full(3, 0.7))


def test_points_lie_on_the_hull_of_a_ball(one_ball: MemoryCapture) -> None:
    """Catches half-pixel and sign errors. The hull must contain the ball and touch the ball near its equator."""
    carved = carve_frame(one_ball.masks[0], one_ball.cameras, box(), points=4000)
    distance = np.linalg.norm(carved.xyz - CENTRE, axis=1)
    pixel = 2 / (1.1 * 128)
    assert carved.xyz.shape == (4000, 3)
    assert distance.min() > RADIUS - pixel
    equator = np.abs(carved.xyz[:, 2] - CENTRE[2]) < 0.1
    assert np.median(distance[equator]) < RADIUS + pixel
    outward = ((carved.xyz - CENTRE) / distance[:, None] * carved.normals).sum(axis=1)
    assert np.median(outward[equator]) > 0.97


def test_points_have_an_even_density(one_ball: MemoryCapture) -> None:
    """Catches clumps and holes in the points. The 5% quantile of the nearest-neighbour distances, divided by their
    mean, is 1 for a lattice and 0.26 for random points."""
    carved = carve_frame(one_ball.masks[0], one_ball.cameras, box(), points=3000)
    nearest = cKDTree(carved.xyz).query(carved.xyz, k=2)[0][:, 1]
    assert np.quantile(nearest, 0.05) > 0.55 * nearest.mean()
    assert carved.spacing == pytest.approx(nearest.mean(), rel=0.5)


@pytest.mark.parametrize("points", [1, 7, 500, 20_000])
def test_returns_the_requested_number_of_points(points: int, one_ball: MemoryCapture) -> None:
    """Catches a number of points that differs from the requested number for unusual sizes."""
    assert len(carve_frame(one_ball.masks[0], one_ball.cameras, box(), points=points).xyz) == points


def test_one_bad_mask_of_twenty_is_tolerated(one_ball: MemoryCapture) -> None:
    """Catches a hull that is emptied by one failed matte or inflated by one white matte."""
    masks = list(one_ball.masks[0])
    masks[4] = np.zeros_like(masks[4])
    carved = carve_frame(masks, one_ball.cameras, box(), points=3000)
    assert np.quantile(np.linalg.norm(carved.xyz - CENTRE, axis=1), 0.05) > RADIUS - 0.03
    masks[4] = np.full_like(masks[4], 255)
    white = carve_frame(masks, one_ball.cameras, box(), points=3000)
    assert np.median(np.linalg.norm(white.xyz - CENTRE, axis=1)) < RADIUS + 0.08


def test_points_outside_some_views_are_kept() -> None:
    """Catches parts of the object that are cut off because a close camera does not see them."""
    cameras = ring_cameras(12, 96)
    close = [camera.crop(30, 30, 36, 36) if index % 4 == 0 else camera for index, camera in enumerate(cameras)]
    masks = [mask(camera, [ball((0, 0, 0), 0.4)]) for camera in close]
    carved = carve_frame(masks, close, box(), points=2000)
    assert carved.xyz[:, 2].max() > 0.35
    assert carved.xyz[:, 2].min() < -0.35


@pytest.mark.parametrize(("cameras", "needed"), [(2, 2), (3, 3), (4, 3), (6, 3), (8, 4), (20, 10)])
def test_minimum_number_of_views(cameras: int, needed: int) -> None:
    """Catches points that only two of four views see, which form ghosts where the rays of two silhouettes intersect."""
    ring = ring_cameras(cameras, 32)
    views = Silhouettes.from_masks(
        [mask(camera, [ball((0, 0, 0), 0.3)]) for camera in ring], ring, np.zeros(3), agreement=0.95, least_views=0.5
    )
    assert views.needed == needed


def test_coarse_to_fine_search_equals_brute_force(one_ball: MemoryCapture) -> None:
    """Catches parts of the surface that are lost by early rejection of cells, and a search that tests every fine
    cell."""
    views = Silhouettes.from_masks(one_ball.masks[0], one_ball.cameras, np.zeros(3), agreement=0.95, least_views=0.5)
    size = 0.04
    lower, upper = np.full(3, -0.64), np.full(3, 0.64)
    cells = surface_cells(views, lower, upper, size)
    axis = np.arange(-0.64 + size / 2, 0.64, size)
    everywhere = np.stack(np.meshgrid(axis, axis, axis, indexing="ij")).reshape(3, -1).astype(np.float32)
    distance, _ = views.distance(everywhere)
    surface = everywhere[:, np.abs(distance) < 0.5 * size]
    reached, _ = cKDTree(cells.T).query(surface.T)
    assert surface.shape[1] > 500
    assert reached.max() < size
    assert cells.shape[1] < 0.3 * everywhere.shape[1]


def test_bounds_are_found_from_masks(one_ball: MemoryCapture) -> None:
    """Catches bounding boxes that cut the object, and bounding boxes that include the whole room."""
    found = hull_bounds(one_ball.masks[0], one_ball.cameras)
    assert np.all(found.lower < CENTRE - RADIUS + 0.01)
    assert np.all(found.upper > CENTRE + RADIUS - 0.01)
    assert found.extent.max() < 2.6 * RADIUS
    both = find_bounds(moving_ball(frames=4))
    assert both.upper[0] > 0.3 + 0.3
    assert both.lower[0] < -0.3


def test_disconnected_objects_are_both_carved(one_ball: MemoryCapture) -> None:
    """Catches a hull that keeps only one connected component."""
    shapes = [ball((-0.35, 0, 0), 0.12), ball((0.35, 0, 0), 0.12)]
    carved = carve_frame([mask(camera, shapes) for camera in one_ball.cameras], one_ball.cameras, box(), points=1000)
    assert (carved.xyz[:, 0] < -0.2).sum() > 300
    assert (carved.xyz[:, 0] > 0.2).sum() > 300


def test_an_empty_hull_names_the_disagreeing_views(one_ball: MemoryCapture) -> None:
    """Catches an error for an empty hull that does not name the cameras to check."""
    masks = list(one_ball.masks[0])
    for index in (3, 11):
        masks[index] = np.zeros_like(masks[index])
        masks[index][:4, :4] = 255
    with pytest.raises(UserError) as caught:
        carve_frame(masks, one_ball.cameras, box(), points=100, agreement=1.0, label="frame 7")
    message = str(caught.value)
    assert message.startswith("frame 7: expected a visual hull")
    assert re.search(r"view 3 .*view 11 ", message)
    assert "\n" not in message
    with pytest.raises(UserError, match="expected an object in the masks, got none in any view"):
        carve_frame([np.zeros_like(m) for m in masks], one_ball.cameras, box(), points=10)


def test_colours_come_from_unoccluded_views(one_ball: MemoryCapture) -> None:
    """Catches colours from views that do not see a point. In views from the right and in views from the left, the ball
    has different colours.
    """
    images = []
    for camera in one_ball.cameras:
        red = 220 if camera.centre[0] > 0 else 20
        images.append(np.full((128, 128, 3), (red, 100, 240 - red), np.uint8))
    carved = carve_frame(one_ball.masks[0], one_ball.cameras, box(), points=2000)
    rgb = colour_points(carved.xyz, carved.normals, carved.spacing, images, one_ball.cameras)
    right, left = carved.normals[:, 0] > 0.9, carved.normals[:, 0] < -0.9
    assert rgb[right, 0].mean() > 200
    assert rgb[left, 0].mean() < 40
    assert np.all(np.abs(rgb[:, 1].astype(int) - 100) <= 1)


def test_carving_resumes_and_invalidates(tmp_path: Path) -> None:
    """Catches frames that are carved twice, old results that are used after a changed setting, and truncated files that
    are kept."""
    capture = moving_ball(frames=3)
    first = carve_capture(capture, tmp_path, points=800)
    times = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.ply")}
    assert sorted(times) == ["000000.ply", "000001.ply", "000002.ply"]
    again = carve_capture(capture, tmp_path, points=800)
    assert np.array_equal(first.lower, again.lower)
    assert times == {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.ply")}
    cut = tmp_path / "000001.ply"
    whole = cut.read_bytes()
    cut.write_bytes(whole[:-40])
    carve_capture(capture, tmp_path, points=800)
    assert cut.read_bytes() == whole
    carve_capture(capture, tmp_path, points=500)
    assert len(read_ply(cut).xyz) == 500
    assert np.all(first.contains(read_ply(cut).xyz))


def test_worker_processes_carve_the_same_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches points that depend on the distribution of frames to processes, and bounds that contain only the last
    frame."""
    capture = moving_ball(frames=4)
    alone = carve_capture(capture, tmp_path / "alone", points=300)
    monkeypatch.setattr(sequence, "MIN_PARALLEL_SECONDS", 0)
    together = carve_capture(capture, tmp_path / "together", points=300, workers=2)
    assert np.array_equal(np.stack([alone.lower, alone.upper]), np.stack([together.lower, together.upper]))
    for path in (tmp_path / "alone").glob("*.ply"):
        assert (tmp_path / "together" / path.name).read_bytes() == path.read_bytes()


def test_an_inset_moves_points_below_the_surface(one_ball: MemoryCapture) -> None:
    """Catches an inset in the wrong direction or in the wrong unit. With a wrong inset, initial discs would extend
    beyond the mattes."""
    flat, inset = (
        carve_frame(one_ball.masks[0], one_ball.cameras, box(), points=4000, inset=spacings) for spacings in (0.0, 0.9)
    )
    moved = (flat.xyz - inset.xyz) / flat.spacing
    np.testing.assert_allclose((moved * flat.normals).sum(axis=1), 0.9, atol=1e-3)


def test_points_of_thin_parts_stay_inside() -> None:
    """Catches an inset that moves the points of a thin part out of the hull on the other side."""
    cameras = tuple(ring_cameras(20, 128))
    masks = [mask(camera, [ball((0.0, 0.0, 0.0), 0.04)]) for camera in cameras]
    carved = carve_frame(masks, cameras, box(), points=40, inset=4.0)
    flat = carve_frame(masks, cameras, box(), points=40)
    assert flat.spacing * 4.0 > 0.04
    views = Silhouettes.from_masks(masks, cameras, box().centre, agreement=0.95, least_views=0.5)
    assert views.distance(np.ascontiguousarray((carved.xyz - box().centre).T.astype(np.float32)))[0].min() > -0.01
    assert (np.linalg.norm(carved.xyz, axis=1) < np.linalg.norm(flat.xyz, axis=1) + 1e-6).all()


def test_a_negative_inset_is_refused(one_ball: MemoryCapture) -> None:
    """Catches points that are moved out of the hull."""
    with pytest.raises(ValueError, match="inset: expected 0 or more, got -1"):
        carve_frame(one_ball.masks[0], one_ball.cameras, box(), points=10, inset=-1.0)
