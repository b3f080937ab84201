"""Repair of a wrong calibration with feature matches, of which a third can be wrong."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.recording.calibration.adjustment.repair import repair_cameras, split_matches
from fourd.recording.calibration.matching import Matches, distort_points
from fourd.recording.calibration.perturbation import perturb_cameras
from fourd.recording.calibration.principal_points import choose_principal_points, principal_point_hypotheses
from tests.captures import ring_cameras

LENS = np.array([-0.12, 0.03, 0.001, -0.001, 0.0])
WIDTH = 800


def _true_cameras(count: int) -> list[Camera]:
    """Cameras with distortion and principal points away from the image centre."""
    cameras = []
    for index, camera in enumerate(ring_cameras(count, WIDTH)):
        intrinsics = camera.intrinsics + np.array([[0, 0, 9.0 + index], [0, 0, -12.0 - index], [0, 0, 0]])
        cameras.append(replace(camera, intrinsics=intrinsics, distortion=LENS))
    return cameras


def _project(cameras: list[Camera], rng: np.random.Generator, wrong: float = 0.0) -> dict[tuple[int, int], Matches]:
    """Matches of 60 points in each pair of cameras. A fraction ``wrong`` of the matches is random."""
    xyz = rng.uniform(-0.6, 0.6, (150, 3))
    pixels = []
    for camera in cameras:
        straight, _ = replace(camera, distortion=None).project(xyz)
        pixels.append(distort_points(camera, straight) + rng.normal(0, 0.25, straight.shape))
    matches = {}
    for i, j in combinations(range(len(cameras)), 2):
        chosen = rng.choice(len(xyz), 60, replace=False)
        other = np.where(rng.random(60) < wrong, rng.integers(0, len(xyz), 60), chosen)
        matches[i, j] = Matches(pixels[i][chosen], pixels[j][other])
    return matches


def test_wrong_poses_are_corrected(rng: np.random.Generator) -> None:
    """Catches a repair that fits wrong matches, or that reports the scores of the matches that it fitted."""
    true = _true_cameras(6)
    given = list(perturb_cameras({str(i): camera for i, camera in enumerate(true)}, 0.6, 0.015, rng).values())
    found = repair_cameras(given, _project(true, rng, wrong=0.3))
    assert found.is_changed
    assert found.before.median_px > 4
    assert found.after.median_px < 1
    assert 0.55 < found.after.share < 0.85
    assert all(lens.distortion is not None for lens in found.cameras)


def test_mirrored_principal_points_are_corrected(rng: np.random.Generator) -> None:
    """Catches a repair that changes poses to explain mirrored principal points."""
    true = _true_cameras(4)
    given = [principal_point_hypotheses(camera)["mirrored x"] for camera in true]
    found = repair_cameras(given, _project(true, rng))
    assert found.trials[0].name == "mirrored principal points"
    assert found.trials[0].is_kept
    assert found.after.median_px < 0.5
    for camera, other in zip(found.cameras, true, strict=True):
        assert np.abs(camera.intrinsics[:2, 2] - other.intrinsics[:2, 2]).max() < 3


def test_a_good_calibration_is_unchanged(rng: np.random.Generator) -> None:
    """Catches corrections that follow the noise of the matches."""
    true = _true_cameras(5)
    found = repair_cameras(true, _project(true, rng, wrong=0.2))
    assert not found.is_changed
    assert found.cameras == tuple(true)


def test_wrong_matches_do_not_join_all_tracks(rng: np.random.Generator) -> None:
    """Catches a split that puts all matches into one part, because wrong matches connect all tracks."""
    matches = _project(_true_cameras(6), rng, wrong=0.3)
    total = sum(map(len, matches.values()))
    fitted, held_out = (sum(map(len, part.values())) for part in split_matches(matches, 6))
    assert fitted > total / 3
    assert held_out > total / 8


def test_held_out_tracks_are_not_fitted(rng: np.random.Generator) -> None:
    """Catches a track with one match among the fitted matches and another match among the held-out matches."""
    fitted, held_out = split_matches(_project(_true_cameras(3), rng), 3)
    seen = [set(map(tuple, np.round(part[0, 1].first_px, 2))) for part in (fitted, held_out)]
    other = [set(map(tuple, np.round(part[0, 2].first_px, 2))) for part in (fitted, held_out)]
    assert seen[0]
    assert seen[1]
    assert not seen[0] & other[1]
    assert not seen[1] & other[0]


@pytest.mark.parametrize("pairs", [[(0, 1)], [(0, 1), (2, 3)]])
def test_wrong_pairs_do_not_hide_mirrored_principal_points(
    rng: np.random.Generator, pairs: list[tuple[int, int]]
) -> None:
    """Catches scores that are means over camera pairs. One pair with wrong matches dominates the mean, so the mean is
    large with every calibration."""
    true = _true_cameras(4)
    matches = _project(true, rng)
    for pair in pairs:
        matches[pair] = Matches(matches[pair].first_px, rng.uniform(100, 700, (60, 2)))
    given = [principal_point_hypotheses(camera)["mirrored y"] for camera in true]
    found = choose_principal_points(matches, given)
    assert found.names == ("mirrored y",) * 4
    assert found.is_clear
    assert found.chosen_px > 4
    assert found.chosen_score.median_px < 1 < 5 < found.given_score.median_px
