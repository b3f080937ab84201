"""Matches on a plane that a camera lies in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fourd.recording.calibration.plane_matching import PlanePatch, match_on_plane
from tests.captures import ring_cameras


def test_a_camera_in_the_plane_has_no_matches(rng: np.random.Generator) -> None:
    """Catches a singular homography if the world's origin is in a camera, whose height is then 0."""
    first, second = ring_cameras(2, 200)
    centre = first.centre * [1, 1, 0]
    first = replace(first, translation=-first.rotation @ centre)
    patch = PlanePatch(np.array([-2.5, 2.5, 0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), 5.0, 5.0, 40.0)
    picture = rng.integers(0, 256, (200, 200, 3), np.uint8)
    assert len(match_on_plane(picture, picture, (first, second), patch)) == 0
