"""Evidence for each camera, and the verdict: good only if matches confirm every camera."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.calibration.checks.agreement import Agreement, CaptureMatches, assess_agreement
from fourd.recording.calibration.checks.verdict import Verdict, describe_residuals, describe_verified, judge
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import Pair
from tests.captures import ring_cameras

NAMES = ("00", "01", "02", "03", "04", "05")


def true_matches(cameras: list[Camera], rng: np.random.Generator, count: int = 60) -> dict[Pair, Matches]:
    """Matches of all pairs with an error of 0.3 pixels."""
    found = {}
    for i, j in combinations(range(len(cameras)), 2):
        xyz = rng.uniform(-0.4, 0.4, (count, 3))
        first, second = (cameras[k].project(xyz)[0] + rng.normal(0, 0.3, (count, 2)) for k in (i, j))
        found[i, j] = Matches(first, second)
    return found


def wrong_matches(rng: np.random.Generator, count: int) -> Matches:
    return Matches(rng.uniform(0, 500, (count, 2)), rng.uniform(0, 500, (count, 2)))


def assess(cameras: list[Camera], matches: dict[Pair, Matches]) -> tuple[Agreement, Verdict]:
    agreement = assess_agreement(Path("capture"), CaptureMatches(NAMES, tuple(cameras), matches))
    return agreement, judge(agreement, agreement.warnings)


def test_confirmed_cameras_are_good_to_use(rng: np.random.Generator) -> None:
    """Catches a verdict that is never good, and figures without the number of matches."""
    cameras = ring_cameras(6, 500)
    agreement, verdict = assess(cameras, true_matches(cameras, rng))
    assert verdict == Verdict("Good to use", True)
    assert describe_verified(agreement) == "verified for 6 of 6 cameras"
    assert "px over 300 matches" in describe_residuals(agreement)


def test_a_handful_of_wrong_matches_is_not_a_wrong_camera(rng: np.random.Generator) -> None:
    """Catches "worst camera: 25, 37.21 px" for a correct camera, of which a few matches are all wrong."""
    cameras = ring_cameras(6, 500)
    matches = true_matches(cameras, rng)
    matches |= {(i, 5): wrong_matches(rng, 0) for i in range(5)} | {(0, 5): wrong_matches(rng, 25)}
    agreement, verdict = assess(cameras, matches)
    assert agreement.worst is not None
    assert agreement.worst.median_px < 1
    assert agreement.suspicious == ()
    assert verdict == Verdict("Usable, but the calibration could not be verified for: 05", False)
    assert "over 25 matches, which are too few to judge)" in describe_verified(agreement)


def test_confirming_pairs_outweigh_wrong_ones(rng: np.random.Generator) -> None:
    """Catches the residual of a correct camera that wrong matches with distant cameras make large."""
    cameras = ring_cameras(6, 500)
    matches = true_matches(cameras, rng) | {(i, 5): wrong_matches(rng, 30) for i in range(2)}
    agreement, verdict = assess(cameras, matches)
    assert verdict.is_good
    assert max(each.median_px for each in agreement.evidence) < 1


def test_no_matches_are_neither_good_nor_bad(rng: np.random.Generator) -> None:
    """Catches "Good to use" over "0 points match"."""
    cameras = ring_cameras(6, 500)
    agreement, verdict = assess(cameras, {pair: wrong_matches(rng, 0) for pair in combinations(range(6), 2)})
    assert not verdict.is_good
    assert verdict.words.startswith("Usable, but the calibration could not be verified: ")
    assert describe_verified(agreement) == "verified for 0 of 6 cameras"


def test_cameras_with_equal_calibrations_are_named(rng: np.random.Generator) -> None:
    """Catches pairs without a baseline, whose residual is always 0, that count as confirmed."""
    cameras = ring_cameras(6, 500)
    matches = {(0, 1): wrong_matches(rng, 200)}
    agreement, verdict = assess([cameras[0], cameras[0], *cameras[2:]], matches)
    assert agreement.score is None
    assert verdict == Verdict("Usable, but the calibration looks wrong for: 00, 01 (see the warnings above)", False)


def test_a_wrong_camera_is_named(rng: np.random.Generator) -> None:
    """Catches a camera that contradicts the others in hundreds of matches and is only called unverified."""
    cameras = ring_cameras(6, 500)
    matches = true_matches(cameras, rng)
    turn = np.array([[np.cos(0.05), -np.sin(0.05), 0], [np.sin(0.05), np.cos(0.05), 0], [0, 0, 1]])
    moved = cameras[2].translation + np.array([0.1, 0.1, 0.0])
    cameras[2] = replace(cameras[2], rotation=turn @ cameras[2].rotation, translation=moved)
    agreement, verdict = assess(cameras, matches)
    assert agreement.suspicious == ("02",)
    assert verdict.words == "Usable, but the calibration looks wrong for: 02 (see the warnings above)"
