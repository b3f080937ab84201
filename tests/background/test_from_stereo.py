"""Background points of a textured room whose walls are known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from fourd.background.from_stereo import seed_from_stereo
from fourd.background.plates import PlateView
from fourd.background.stereo.sparse import triangulate_sparse
from fourd.cameras import look_at
from fourd.errors import UserError
from fourd.ply import ColouredPoints
from fourd.progress import untracked
from tests.calibration.rooms import HALF_WIDTH, HEIGHT, Room, room_cameras

HOLE = ((0.7, 1.5), (0.5, 1.3))
"""y and z of a rectangle on the wall x = 2 that no plate shows."""
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
    """(N,) which points lie within HOLE's sides, at any x."""
    (front, back), (low, high) = HOLE
    inside = (xyz[:, 1] > front + margin) & (xyz[:, 1] < back - margin)
    return inside & (xyz[:, 2] > low + margin) & (xyz[:, 2] < high - margin) & (xyz[:, 0] > 0)


def beside_a_hole(xyz: np.ndarray, plates: list[PlateView]) -> bool:
    """Whether a point (3,) lies in what some plate has seen."""
    for each in plates:
        pixels, depth = each.camera.project(xyz[None])
        column, row = np.floor(pixels[0]).astype(int)
        if each.camera.is_in_image(pixels, depth)[0] and each.seen[min(row, 131), min(column, 175)]:
            return True
    return False


def plate(room: Room, index: int) -> PlateView:
    """A camera's picture of the room with magenta in the hole."""
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


@pytest.fixture(scope="module")
def stage() -> Stage:
    """Points of four plates of a room, with guesses for what no two of them show alike."""
    room = Room(np.random.default_rng(3))
    plates = [plate(room, index) for index in range(4)]
    lines: list[str] = []
    return Stage(plates, seed_from_stereo(plates, 2000, log=lines.append), lines)


def test_points_lie_on_the_walls(stage: Stage) -> None:
    """Catches cameras that were adjusted, half pixels lost between conventions, and matches at the wrong place."""
    apart = to_walls(stage.points.xyz)
    assert np.median(apart) < 0.003
    assert np.percentile(apart, 90) < 0.02
    assert np.percentile(apart, 99) < 0.15


def test_features_lie_on_the_walls(stage: Stage) -> None:
    """Catches poses that COLMAP adjusted or counts otherwise, and wrong matches that three plates share."""
    features = triangulate_sparse(stage.plates, 0, untracked)
    apart = to_walls(features.xyz)[features.reliable]
    assert len(apart) > 100
    assert np.median(apart) < 0.005
    assert np.percentile(apart, 95) < 0.03
    assert not in_hole(features.xyz[to_walls(features.xyz) < 0.05]).any()


def test_points_have_the_walls_colours(stage: Stage) -> None:
    """Catches swapped channels, and colours taken half a picture away."""
    view = stage.plates[1]
    pixels, depth = view.camera.project(stage.points.xyz)
    inside = (depth > 0) & (pixels > 1).all(axis=1) & (pixels < (175, 131)).all(axis=1)
    columns, rows = pixels[inside].astype(int).T
    apart = np.abs(view.rgb[rows, columns].astype(int) - stage.points.rgb[inside])
    assert inside.sum() > 500
    assert np.median(apart, axis=0).max() < 12


def test_holes_have_no_points(stage: Stage) -> None:
    """Catches features and guesses made of what a hole was filled with."""
    found = stage.points
    on_wall = found.xyz[to_walls(found.xyz) < 0.05]
    # One that lies off the wall may be beside the hole for a camera that looks along the wall: that one sees it.
    assert all(beside_a_hole(xyz, stage.plates) for xyz in on_wall[in_hole(on_wall, margin=0.05)])
    assert not in_hole(found.xyz[to_walls(found.xyz) < 0.03], margin=0.05).any()
    assert (np.abs(found.rgb.astype(int) - MAGENTA).max(axis=1) > 12).all(), "walls have 20 to 235"
    assert in_hole(stage.points.xyz, margin=-0.3).any(), "the wall about it has some"


def test_every_equal_area_has_its_point(stage: Stage) -> None:
    """Catches points spread over the world instead of the pictures, and gaps where one plate alone shows a place."""
    assert 1800 <= len(stage.points.xyz) <= 2000
    for view in stage.plates:
        pixels, depth = view.camera.project(stage.points.xyz)
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (176, 132)).all(axis=1)
        counts, _, _ = np.histogram2d(*pixels[inside].T, bins=(8, 6), range=((0, 176), (0, 132)))
        seen = view.seen[:132, :176].reshape(6, 22, 8, 22).mean(axis=(1, 3)).T > 0.9
        assert counts[seen].min() >= 0.2 * np.median(counts[seen])
        assert counts[seen].max() <= 5 * np.median(counts[seen])


def test_any_prefix_is_a_fair_sample(stage: Stage) -> None:
    """Catches points in the plates' order, of which a caller that takes the first gets one corner."""
    half = stage.points.xyz[: len(stage.points.xyz) // 2]
    spread = stage.points.xyz.std(axis=0)
    assert np.allclose(half.mean(axis=0), stage.points.xyz.mean(axis=0), atol=0.15 * spread.max())


def test_what_was_found_is_told(stage: Stage) -> None:
    """Catches guesses that pass for measurements without a word."""
    features, points = stage.lines
    assert features.startswith("features: ")
    assert f"points: {len(stage.points.xyz)}, " in points
    assert "of what no two plates show alike" in points


def test_blank_walls_cannot_be_triangulated(stage: Stage) -> None:
    """Catches an empty cloud, or a crash in place of the way out."""
    blank = [replace(view, rgb=np.full_like(view.rgb, 200), seen=np.ones_like(view.seen)) for view in stage.plates]
    with pytest.raises(
        UserError, match=r"plates: expected at least 8 features .*, got 0; .*--background FILE.ply"
    ) as caught:
        seed_from_stereo(blank, 1000)
    assert "\n" not in str(caught.value)


def test_plates_with_nothing_in_common(rng: np.random.Generator) -> None:
    """Catches chance matches that pass for a background: cameras that look away from each other share no place."""
    up, intrinsics = np.array([0.0, 0.0, 1.0]), np.array([[140.0, 0, 88], [0, 140, 66], [0, 0, 1]])
    plates, room = [], Room(rng)
    for index, side in enumerate((1.0, -1.0)):
        camera = look_at(np.array([0.1 * side, 0.0, 1.0]), np.array([2 * side, 0.0, 1.0]), up, intrinsics, 176, 132)
        plates.append(PlateView(f"{index}", camera, room.picture(camera), np.ones((132, 176), bool)))
    with pytest.raises(UserError, match=r"plates: expected at least .* in two of them alike, got .*--background"):
        seed_from_stereo(plates, 1000)


@pytest.mark.parametrize(("count", "points"), [(1, 10), (3, 0)])
def test_impossible_wishes(stage: Stage, count: int, points: int) -> None:
    """Catches a failure deep inside for a call that cannot be meant."""
    with pytest.raises(ValueError, match="expected at least 2 plates and 1 point"):
        seed_from_stereo(stage.plates[:count], points)


@pytest.mark.slow
def test_same_points_from_any_number_of_processes(stage: Stage) -> None:
    """Catches chance that depends on which process makes a map, or when."""
    again = seed_from_stereo(stage.plates, 2000, workers=2)
    assert np.array_equal(again.xyz, stage.points.xyz)
    assert np.array_equal(again.rgb, stage.points.rgb)


@pytest.mark.slow
def test_measured_points_alone(stage: Stage) -> None:
    """Catches guesses where none were asked for: what is left is measured to millimetres."""
    measured = seed_from_stereo(stage.plates, 100_000, fill=False)
    assert 5_000 < len(measured.xyz) < 100_000
    assert np.percentile(to_walls(measured.xyz), 90) < 0.01
