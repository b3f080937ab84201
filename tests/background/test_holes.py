"""Holes in a background of points: they are found where a plate shows a surface, and filled from their borders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fourd.base.formats.ply import ColouredPoints
from fourd.reconstruction.background.holes import fill_holes, measure_coverage
from fourd.reconstruction.background.plates import PlateView
from tests.calibration.rooms import Room, room_cameras, room_depth

NEAR = 0.1


@pytest.fixture(scope="module")
def plates() -> list[PlateView]:
    """Plates of two neighbouring cameras in a room."""
    room = Room(np.random.default_rng(0))
    return [
        PlateView(f"{index}", camera, room.picture(camera), np.ones((camera.height, camera.width), np.bool_))
        for index, camera in enumerate(room_cameras(8, 160, 120)[:2])
    ]


@pytest.fixture(scope="module")
def surface(plates: list[PlateView]) -> ColouredPoints:
    """Points on all surfaces that the first plate shows, in every pixel."""
    camera = plates[0].camera
    rows, columns = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    xyz = camera.unproject(np.column_stack([columns, rows]) + 0.5, room_depth(camera)[rows, columns].ravel())
    return ColouredPoints(xyz.astype(np.float32), plates[0].rgb[rows, columns])


def without(points: ColouredPoints, plate: PlateView, left: int, top: int, side: int) -> ColouredPoints:
    """Remove the points in a square of a plate."""
    pixels, _ = plate.camera.project(points.xyz)
    kept = ~((pixels >= (left, top)) & (pixels < (left + side, top + side))).all(axis=1)
    return ColouredPoints(points.xyz[kept], points.rgb[kept])


def test_a_hole_is_filled_on_the_wall(plates: list[PlateView], surface: ColouredPoints) -> None:
    """Catches a view that stays black where its plate shows a wall, and points in front of or behind this wall."""
    plate = plates[0]
    holed = without(surface, plate, 60, 40, 30)
    assert measure_coverage(surface, plates[:1], NEAR).least > 0.999
    assert measure_coverage(holed, plates[:1], NEAR).least == pytest.approx(1 - 30 * 30 / (160 * 120), abs=0.01)
    added = fill_holes(holed, plates[:1], NEAR)
    both = ColouredPoints(np.concatenate([holed.xyz, added.xyz]), np.concatenate([holed.rgb, added.rgb]))
    assert measure_coverage(both, plates[:1], NEAR).least > 0.995
    pixels, depth = plate.camera.project(added.xyz)
    columns, rows = pixels.astype(int).T
    true = room_depth(plate.camera)[rows, columns]
    assert np.median(np.abs(depth - true) / true) < 0.05
    assert np.abs(added.rgb.astype(int) - plate.rgb[rows, columns]).max() == 0


def test_areas_that_the_plate_does_not_show_are_no_holes(plates: list[PlateView], surface: ColouredPoints) -> None:
    """Catches points where the subject hides the background in every frame, whose colours are unknown."""
    seen = np.ones((120, 160), np.bool_)
    seen[35:75, 55:95] = False
    hidden = replace(plates[0], seen=seen)
    holed = without(surface, plates[0], 60, 40, 30)
    assert measure_coverage(holed, [hidden], NEAR).least > 0.99
    assert len(fill_holes(holed, [hidden], NEAR).xyz) == 0


def test_nothing_is_added_to_a_whole_surface(plates: list[PlateView], surface: ColouredPoints) -> None:
    """Catches points that are added to gaps between discs."""
    assert len(fill_holes(surface, plates[:1], NEAR).xyz) < 5
    assert str(measure_coverage(surface, plates[:1], NEAR)).startswith("100.0% of the plates' area (least: camera '0'")
