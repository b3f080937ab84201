"""Measuring distances in a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fourd.base.units import format_length
from fourd.viewer.measuring.measurement import Measurement
from fourd.viewer.measuring.pick import pick
from tests.baking.scenes import ring
from tests.viewer.scenes import shell_frame

CAMERA = ring(3)[1]


def test_a_click_finds_the_front_of_a_surface() -> None:
    """Catches a click that finds the far side of a subject, one that misses between the centres of points, and one that
    finds a faint or a hidden point."""
    frame = shell_frame(4000, seed=1)  # a sphere with the radius 0.5
    centre = CAMERA.project(np.zeros((1, 3)))[0][0]
    to_camera = CAMERA.centre / np.linalg.norm(CAMERA.centre)
    found = pick(frame, CAMERA, (centre[0], centre[1]), near=0.01)
    assert found is not None
    assert np.linalg.norm(found - 0.5 * to_camera) < 0.04
    behind = pick(frame, CAMERA, (centre[0], centre[1]), near=float(np.linalg.norm(CAMERA.centre)))
    assert behind is not None
    assert np.linalg.norm(behind + 0.5 * to_camera) < 0.04
    assert pick(frame, CAMERA, (1.0, 1.0), near=0.01) is None
    assert pick(replace(frame, density=np.zeros_like(frame.density)), CAMERA, (24, 24), near=0.01) is None


def test_a_third_click_starts_the_next_measurement() -> None:
    """Catches a length between the wrong places."""
    measurement = Measurement()
    measurement.toggle()
    for place, length in (((0, 0, 0), None), ((0, 3, 4), 5.0), ((1, 1, 1), None), ((1, 1, 2), 1.0)):
        measurement.choose(np.array(place, np.float64))
        assert measurement.length == (None if length is None else pytest.approx(length))
    measurement.toggle()
    assert not measurement.places


@pytest.mark.parametrize(
    ("metres_per_unit", "text"), [(None, "1.250 world units"), (1.0, "1.250 m"), (0.001, "0.001 m"), (2.0, "2.500 m")]
)
def test_a_length_has_a_unit(metres_per_unit: float | None, text: str) -> None:
    """Catches metres that are none, and millimetres that are taken for metres."""
    assert format_length(1.25, metres_per_unit, ".3f") == text
