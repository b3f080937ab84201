"""Background points by stereo of a textured room with known walls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from fourd.base.cameras import look_at
from fourd.base.errors import UserError
from fourd.base.formats.ply import ColouredPoints
from fourd.base.progress import untracked
from fourd.reconstruction.background.from_stereo import seed_from_stereo
from fourd.reconstruction.background.plates import PlateView
from fourd.recording.stereo.depth_maps import StereoResult, reconstruct_surfaces
from fourd.recording.stereo.sparse import triangulate_sparse
from tests.calibration.rooms import HALF_WIDTH, HEIGHT, Room, room_cameras

HOLE = ((0.7, 1.5), (0.5, 1.3))
"""A rectangle on the wall x = 2, as ranges of y and z. Every plate has a hole at this rectangle."""
MAGENTA = (255, 0, 255)


@dataclass(frozen=True)
class Stage:
    plates: list[PlateView]
    points: ColouredPoints
    lines: list[str]


def to_walls(xyz: np.ndarray) -> np.ndarray:
    """(N,) distance to the nearest face of the room."""
    x, y, z = np.abs(xyz.astype(np.float64).T)
    return np.min([np.abs(x - HALF_WIDTH), np.abs(y - HALF_WIDTH), z, np.abs(z - HEIGHT)], axis=0)


def in_hole(xyz: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """(N,) bool: whether a point has x > 0 and lies within the y and z ranges of HOLE."""
    (front, back), (low, high) = HOLE
    inside = (xyz[:, 1] > front + margin) & (xyz[:, 1] < back - margin)
    return inside & (xyz[:, 2] > low + margin) & (xyz[:, 2] < high - margin) & (xyz[:, 0] > 0)


def is_seen(xyz: np.ndarray, plates: list[PlateView]) -> bool:
    """Whether a point (3,) projects to a visible pixel of at least one plate."""
    for each in plates:
        pixels, depth = each.camera.project(xyz[None])
        column, row = np.floor(pixels[0]).astype(int)
        if each.camera.is_in_image(pixels, depth)[0] and each.seen[min(row, 131), min(column, 175)]:
            return True
    return False


def plate(room: Room, index: int) -> PlateView:
    """A camera's image of the room, in which the hole is magenta."""
    camera = room_cameras(4, 176, 132)[index]
    rgb = room.picture(camera)
    rows, columns = np.indices(rgb.shape[:2])
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones_like(rows)], axis=-1).reshape(-1, 3)
    rays = pixels @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
    with np.errstate(divide="ignore"):
        place = camera.centre + rays * ((HALF_WIDTH - camera.centre[0]) / rays[:, 0])[:, None]
    hole = (in_hole(place) & (rays[:, 0] > 0)).reshape(rgb.shape[:2])
    rgb[hole] = MAGENTA
    return PlateView(f"{index:02d}", camera, rgb, ~hole)


def seeds(plates: list[PlateView], points: int, workers: int = 1, **settings: Any) -> ColouredPoints:
    return seed_from_stereo(plates, reconstruct_surfaces(plates, 0, workers, untracked), points, **settings)


@pytest.fixture(scope="module")
def stage() -> Stage:
    """Points of four plates of a room, with extrapolated depths."""
    room = Room(np.random.default_rng(3))
    plates = [plate(room, index) for index in range(4)]
    lines: list[str] = []
    return Stage(plates, seeds(plates, 2000, log=lines.append), lines)


def test_points_lie_on_the_walls(stage: Stage) -> None:
    """Catches cameras that are changed by COLMAP, half-pixel errors between pixel conventions, and wrong matches."""
    distance = to_walls(stage.points.xyz)
    assert np.median(distance) < 0.003
    assert np.percentile(distance, 90) < 0.02
    assert np.percentile(distance, 99) < 0.15


def test_features_lie_on_the_walls(stage: Stage) -> None:
    """Catches poses that are changed or permuted by COLMAP, and wrong matches in three plates."""
    features = triangulate_sparse(stage.plates, 0, untracked)
    distance = to_walls(features.xyz)[features.reliable]
    assert len(distance) > 100
    assert np.median(distance) < 0.005
    assert np.percentile(distance, 95) < 0.03
    assert not in_hole(features.xyz[to_walls(features.xyz) < 0.05]).any()


def test_points_have_the_walls_colours(stage: Stage) -> None:
    """Catches swapped channels and colours sampled at wrong pixels."""
    view = stage.plates[1]
    pixels, depth = view.camera.project(stage.points.xyz)
    inside = (depth > 0) & (pixels > 1).all(axis=1) & (pixels < (175, 131)).all(axis=1)
    columns, rows = pixels[inside].astype(int).T
    difference = np.abs(view.rgb[rows, columns].astype(int) - stage.points.rgb[inside])
    assert inside.sum() > 500
    assert np.median(difference, axis=0).max() < 12


def test_holes_have_no_points(stage: Stage) -> None:
    """Catches features and extrapolated depths inside holes."""
    found = stage.points
    on_wall = found.xyz[to_walls(found.xyz) < 0.05]
    # From a grazing angle, a camera can see a point slightly in front of the wall beside the hole.
    assert all(is_seen(xyz, stage.plates) for xyz in on_wall[in_hole(on_wall, margin=0.05)])
    assert not in_hole(found.xyz[to_walls(found.xyz) < 0.03], margin=0.05).any()
    assert (np.abs(found.rgb.astype(int) - MAGENTA).max(axis=1) > 12).all(), "walls have 20 to 235"
    assert in_hole(stage.points.xyz, margin=-0.3).any(), "the wall around the hole has points"


def test_points_have_an_even_density_in_the_pictures(stage: Stage) -> None:
    """Catches points that are evenly spaced in the world instead of in the images, and gaps on walls that only one
    plate shows."""
    assert 1800 <= len(stage.points.xyz) <= 2000
    for view in stage.plates:
        pixels, depth = view.camera.project(stage.points.xyz)
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (176, 132)).all(axis=1)
        counts, _, _ = np.histogram2d(*pixels[inside].T, bins=(8, 6), range=((0, 176), (0, 132)))
        seen = view.seen[:132, :176].reshape(6, 22, 8, 22).mean(axis=(1, 3)).T > 0.9
        assert counts[seen].min() >= 0.2 * np.median(counts[seen])
        assert counts[seen].max() <= 5 * np.median(counts[seen])


def test_any_prefix_is_a_uniform_sample(stage: Stage) -> None:
    """Catches points that are stored plate by plate, so that the first half of the points covers only one corner."""
    half = stage.points.xyz[: len(stage.points.xyz) // 2]
    spread = stage.points.xyz.std(axis=0)
    assert np.allclose(half.mean(axis=0), stage.points.xyz.mean(axis=0), atol=0.15 * spread.max())


def test_extrapolated_points_are_reported(stage: Stage) -> None:
    """Catches extrapolated points that are counted as measured points."""
    features, points = stage.lines
    assert features.startswith("features: ")
    assert f"points: {len(stage.points.xyz)}, " in points
    assert "extrapolated where no two plates match" in points


def test_blank_walls_are_an_error(stage: Stage) -> None:
    """Catches an empty result or a traceback instead of an error message that suggests a fix."""
    blank = [replace(view, rgb=np.full_like(view.rgb, 200), seen=np.ones_like(view.seen)) for view in stage.plates]
    with pytest.raises(
        UserError, match=r"plates: expected at least 8 features .*, got 0; .*--background FILE.ply"
    ) as caught:
        seeds(blank, 1000)
    assert "\n" not in str(caught.value)


def test_plates_without_overlap_are_an_error(rng: np.random.Generator) -> None:
    """Catches a background made from random matches. The cameras face away from each other, so their images do not
    overlap."""
    up, intrinsics = np.array([0.0, 0.0, 1.0]), np.array([[140.0, 0, 88], [0, 140, 66], [0, 0, 1]])
    plates, room = [], Room(rng)
    for index, side in enumerate((1.0, -1.0)):
        camera = look_at(np.array([0.1 * side, 0.0, 1.0]), np.array([2 * side, 0.0, 1.0]), up, intrinsics, 176, 132)
        plates.append(PlateView(f"{index}", camera, room.picture(camera), np.ones((132, 176), bool)))
    with pytest.raises(UserError, match=r"plates: expected at least .* match between two plates, got .*--background"):
        seeds(plates, 1000)


@pytest.mark.parametrize(("count", "points"), [(1, 10), (3, 0)])
def test_invalid_arguments(stage: Stage, count: int, points: int) -> None:
    """Catches invalid arguments without an error that names the expected values."""
    with pytest.raises(ValueError, match="expected at least 2 plates and 1 point"):
        seed_from_stereo(stage.plates[:count], StereoResult(0, 0, [], []), points)


@pytest.mark.slow
def test_same_points_from_any_number_of_processes(stage: Stage) -> None:
    """Catches results that depend on the number of processes or on the order of the depth maps."""
    again = seeds(stage.plates, 2000, workers=2)
    assert np.array_equal(again.xyz, stage.points.xyz)
    assert np.array_equal(again.rgb, stage.points.rgb)


@pytest.mark.slow
def test_measured_points_only(stage: Stage) -> None:
    """Catches points that are extrapolated although ``fill`` is False. Without extrapolation, all points are within 1
    cm of the walls."""
    measured = seeds(stage.plates, 100_000, fill=False)
    assert 5_000 < len(measured.xyz) < 100_000
    assert np.percentile(to_walls(measured.xyz), 90) < 0.01
