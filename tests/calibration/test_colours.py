"""Colour differences between cameras: matches with known gains and offsets."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from fourd.recording.calibration.colours import ColourMatches, concatenate, measure_colours, sample_colours
from fourd.recording.calibration.matching import Matches

CAMERAS = 6
TRAINING = [0, 1, 2, 3, 4]


def make_matches(
    seed: int, gain: np.ndarray, offset: np.ndarray, *, noise: float = 0.01, wrong: float = 0.1, count: int = 400
) -> ColourMatches:
    """Matches of points with random colours, of which a fraction ``wrong`` shows two different points."""
    rng = np.random.default_rng(seed)
    first = rng.integers(0, CAMERAS, count)
    second = (first + rng.integers(1, CAMERAS, count)) % CAMERAS
    scene = rng.uniform(0.15, 0.75, (count, 3))
    other = np.where(rng.random((count, 1)) < wrong, rng.uniform(0.15, 0.75, (count, 3)), scene)
    colours = [
        gain[camera] * rgb + offset[camera] + rng.normal(0, noise, (count, 3))
        for camera, rgb in ((first, scene), (second, other))
    ]
    return ColourMatches(first, second, *colours, CAMERAS)


def random_cameras(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Gains and offsets (V, 3). Their mean over the training cameras is the identity."""
    rng = np.random.default_rng(seed)
    gain, offset = rng.uniform(0.85, 1.15, (CAMERAS, 3)), rng.uniform(-0.02, 0.02, (CAMERAS, 3))
    return gain / gain[TRAINING].mean(axis=0), offset - offset[TRAINING].mean(axis=0)


@pytest.mark.parametrize("seed", range(3))
def test_gains_are_found_despite_wrong_matches(seed: int) -> None:
    """Catches maps in the wrong direction, maps that wrong matches decide, and a held-out camera without a map."""
    gain, offset = random_cameras(seed)
    found = measure_colours(make_matches(seed, gain, offset), TRAINING)
    grey = np.full(3, 0.5)
    expected, got = gain * grey + offset, found.maps[:, :, :3] @ grey + found.maps[:, :, 3]
    assert found.differ
    assert np.abs(got - expected).max() < 0.02
    assert found.after < 0.02 < found.before


@pytest.mark.parametrize("seed", range(3))
def test_equal_cameras_are_not_corrected(seed: int) -> None:
    """Catches a correction that only fits noise."""
    found = measure_colours(make_matches(seed, np.ones((CAMERAS, 3)), np.zeros((CAMERAS, 3)), noise=0.03), TRAINING)
    assert not found.differ


def test_held_out_cameras_change_no_training_camera() -> None:
    """Catches held-out images that influence the scene."""
    gain, offset = random_cameras(0)
    matches = make_matches(0, gain, offset)
    changed = gain.copy()
    changed[5] = 1.4
    darker = make_matches(0, changed, offset)
    first, second = (measure_colours(each, TRAINING).maps for each in (matches, darker))
    assert np.array_equal(first[TRAINING], second[TRAINING])
    assert np.abs(first[5] - second[5]).max() > 0.1


def test_cameras_without_matches_keep_their_colours() -> None:
    """Catches a singular system, and maps that nothing determines."""
    gain, offset = random_cameras(1)
    matches = make_matches(1, gain, offset)
    lonely = matches.select((matches.first != 2) & (matches.second != 2))
    found = measure_colours(lonely, TRAINING)
    assert np.allclose(found.maps[2], np.eye(3, 4), atol=0.06)
    few = measure_colours(matches.select(np.arange(len(matches.first)) < 40), TRAINING)
    assert not few.differ
    assert np.array_equal(few.maps, np.tile(np.eye(3, 4), (CAMERAS, 1, 1)))
    assert not measure_colours(matches.select(np.zeros(len(matches.first), bool)), TRAINING).differ


def test_colours_are_sampled_at_the_matches() -> None:
    """Catches swapped rows and columns, a shift by half a pixel, and empty pairs."""
    first = np.zeros((40, 60, 3), np.uint8)
    second = np.zeros((40, 60, 3), np.uint8)
    first[:, 30:], second[20:] = (200, 100, 50), (100, 50, 25)
    found = Matches(np.array([[45.5, 10.5], [10.5, 10.5]]), np.array([[10.5, 30.5], [10.5, 5.5]]))
    empty = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    sampled = sample_colours([first, second, first], {(0, 1): found, (0, 2): empty})
    assert sampled.first.tolist() == [0, 0]
    assert sampled.second.tolist() == [1, 1]
    assert np.allclose(sampled.first_rgb * 255, [[200, 100, 50], [0, 0, 0]])
    assert np.allclose(sampled.second_rgb * 255, [[100, 50, 25], [0, 0, 0]])
    assert len(concatenate([sampled, sampled]).first) == 4


@pytest.mark.parametrize(
    ("gains", "count", "text"),
    [
        (True, 400, r"the cameras differ by \d+\.\d of 255 levels between \d+ matching points, .*--keep-colours"),
        (
            False,
            400,
            r"\d\.\d of 255 levels between \d+ matching points, .*; not corrected, because a gain hardly reduces",
        ),
        (None, 400, r"[01]\.\d of 255 levels between \d+ matching points; no correction is needed"),
        (True, 30, r"not compared: \d+ matching points are too few"),
    ],
)
def test_the_check_says_what_was_found(gains: bool | None, count: int, text: str) -> None:
    """Catches a report that hides a difference, that calls too few matches an agreement, or that calls differences of
    20 levels no reason for a correction when a correction was tried in vain."""
    gain, offset = random_cameras(0) if gains else (np.ones((CAMERAS, 3)), np.zeros((CAMERAS, 3)))
    matches = make_matches(0, gain, offset, count=count)
    if gains is None:
        matches = replace(matches, second_rgb=matches.first_rgb)
    assert re.search(text, measure_colours(matches, TRAINING).describe())
