"""Bundle adjustment of degenerate input: no traceback of a linear solver, and no camera that is not finite."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.calibration.adjustment.repair import repair_cameras
from fourd.recording.calibration.adjustment.tracks import Observations, triangulate_points
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import Pair
from tests.captures import ring_cameras


def test_cameras_that_face_each_other_do_not_determine_a_point() -> None:
    """Catches a singular matrix if a track's rays lie on the line between two cameras."""
    intrinsics = np.array([[100, 0, 50], [0, 100, 50], [0, 0, 1.0]])
    first = Camera(intrinsics, np.eye(3), np.zeros(3), 100, 100)
    turned = np.diag([-1.0, 1.0, -1.0])
    second = Camera(intrinsics, turned, np.array([0, 0, 4.0]), 100, 100)
    tracks = Observations(np.array([0, 1]), np.array([0, 0]), np.array([[50.0, 50.0], [50.0, 50.0]]))
    xyz, is_wide = triangulate_points(tracks, [first, second])
    assert np.isfinite(xyz).all()
    assert not is_wide.any()


def test_equal_cameras_and_random_matches_can_be_repaired(rng: np.random.Generator) -> None:
    """Catches LinAlgError and ValueError from a bundle adjustment that diverges."""
    for count in (20, 200):
        cameras = ring_cameras(4, 200)
        cameras[1] = cameras[0]
        cameras[2] = replace(cameras[2], translation=cameras[2].translation + 1e-9)
        matches: dict[Pair, Matches] = {
            (i, j): Matches(rng.uniform(0, 200, (count, 2)), rng.uniform(0, 200, (count, 2)))
            for i in range(4)
            for j in range(i + 1, 4)
        }
        found = repair_cameras(cameras, matches)
        assert len(found.cameras) == 4
