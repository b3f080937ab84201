"""Colour differences between cameras, from the colours at matching points.

Cameras of one rig often differ in exposure and white balance. Each camera gets a gain and an offset per channel, such
that matching points have the same colours in all cameras after the correction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import Pair

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

BLUR_PX = 2.0
"""Standard deviation of the blur before colours are sampled, because matching points are not at exactly the same
place."""
DARKEST, BRIGHTEST = 0.02, 0.97
"""Range of colours that are compared. Sensors cut off darker and brighter colours."""
PRIOR = 0.5
OFFSET_PRIOR = 2.0
"""Weights that pull gains to 1 and offsets to 0, in units of one match. They decide for cameras with few matches."""
ITERATIONS = 8
FOLDS = 5
MIN_MATCHES = 60
MIN_DIFFERENCE_LEVELS = 2.0
"""Cameras differ if matching points differ by at least this many of 255 levels, and if the correction removes at least
MIN_REDUCTION of it at matches that were not used for the correction."""
MIN_REDUCTION = 0.2


@dataclass(frozen=True, eq=False)
class ColourMatches:
    """Colours at M matching points of V cameras.

    Attributes:
        first, second: (M,) indices of the cameras.
        first_rgb, second_rgb: (M, 3) colours in [0, 1].
        cameras: number V of cameras.
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    first_rgb: Array
    second_rgb: Array
    cameras: int

    def select(self, rows: NDArray[np.bool_]) -> ColourMatches:
        """Select the matches for which the mask ``rows`` (M,) is true."""
        return ColourMatches(
            self.first[rows], self.second[rows], self.first_rgb[rows], self.second_rgb[rows], self.cameras
        )


@dataclass(frozen=True, eq=False)
class ColourDifferences:
    """Colour differences between V cameras.

    Attributes:
        maps: (V, 3, 4) affine map ``[M, offset]`` from the scene's colours to each camera's colours, in [0, 1].
        before: median absolute difference between the colours of matching points.
        after: the same after the correction, at matches that were not used to estimate the correction.
        matches: number of matches.
    """

    maps: Array
    before: float
    after: float
    matches: int

    @property
    def differ(self) -> bool:
        """Whether the matches show that the cameras differ."""
        is_large = 255 * self.before >= MIN_DIFFERENCE_LEVELS and self.after <= (1 - MIN_REDUCTION) * self.before
        return self.matches >= MIN_MATCHES and is_large

    def describe(self) -> str:
        """Say in one line whether the cameras differ, and what a run does."""
        if self.matches < MIN_MATCHES:
            return f"not compared: {self.matches} matching points are too few"
        if self.differ:
            return f"the cameras differ by {self}; a run corrects this (--keep-colours: it does not)"
        if 255 * self.before < MIN_DIFFERENCE_LEVELS:
            return (
                f"{255 * self.before:.1f} of 255 levels between {self.matches} matching points; no correction is needed"
            )
        return f"{self}; not corrected, because a gain hardly reduces the differences"

    def __str__(self) -> str:
        before, after = (f"{255 * value:.1f}" for value in (self.before, self.after))
        return f"{before} of 255 levels between {self.matches} matching points, {after} after a gain per camera"


def sample_colours(pictures: Sequence[Picture], matches: Mapping[Pair, Matches]) -> ColourMatches:
    """Sample the colours at the matches of one frame.

    Args:
        pictures: one RGB image (H, W, 3) per camera.
        matches: positions in these images.
    """
    blurred = [np.asarray(cv2.GaussianBlur(picture, (0, 0), BLUR_PX), np.uint8) for picture in pictures]
    pairs = [(pair, found) for pair, found in matches.items() if len(found)]
    empty = np.zeros((0, 3))
    return ColourMatches(
        np.concatenate([np.zeros(0, np.intp), *(np.full(len(found), i, np.intp) for (i, _), found in pairs)]),
        np.concatenate([np.zeros(0, np.intp), *(np.full(len(found), j, np.intp) for (_, j), found in pairs)]),
        np.concatenate([empty, *(_colours_at(blurred[i], found.first_px) for (i, _), found in pairs)]),
        np.concatenate([empty, *(_colours_at(blurred[j], found.second_px) for (_, j), found in pairs)]),
        len(pictures),
    )


def concatenate(parts: Sequence[ColourMatches]) -> ColourMatches:
    """Concatenate the matches of several frames of the same cameras."""
    return ColourMatches(
        np.concatenate([part.first for part in parts]),
        np.concatenate([part.second for part in parts]),
        np.concatenate([part.first_rgb for part in parts]),
        np.concatenate([part.second_rgb for part in parts]),
        parts[0].cameras,
    )


def measure_colours(matches: ColourMatches, training: Sequence[int], seed: int = 0) -> ColourDifferences:
    """Estimate the colour map of each camera.

    The maps of the cameras ``training`` are estimated first, from the matches between them, such that their mean
    correction is the identity. The maps of the other cameras, which are held out, follow from their matches with the
    training cameras. Iteratively reweighted least squares with Cauchy weights is used, because reflections and wrong
    matches differ for other reasons.
    """
    colours = np.hstack([matches.first_rgb, matches.second_rgb])
    matches = matches.select(np.all((colours > DARKEST) & (colours < BRIGHTEST), axis=1))
    is_training = np.isin(np.arange(matches.cameras), training)
    between = matches.select(is_training[matches.first] & is_training[matches.second])
    count = len(between.first)
    if count < MIN_MATCHES:
        identity = np.tile(np.eye(3, 4), (matches.cameras, 1, 1))
        return ColourDifferences(identity, 0.0, 0.0, count)
    fold = np.random.default_rng(seed).integers(0, FOLDS, count)
    given = np.ones((matches.cameras, 3)), np.zeros((matches.cameras, 3))
    left = np.concatenate(
        [
            _differences(between.select(fold == each), *_fit(between.select(fold != each), given, is_training))
            for each in range(FOLDS)
        ]
    )
    gain, offset = _fit(matches, _fit(between, given, is_training), ~is_training)
    maps = np.zeros((matches.cameras, 3, 4))
    maps[:, range(3), range(3)] = 1 / gain
    maps[:, :, 3] = -offset / gain
    before = float(np.median(np.abs(between.first_rgb - between.second_rgb)))
    return ColourDifferences(maps, before, float(np.median(np.abs(left))), count)


def _colours_at(picture: Picture, xy_px: Array) -> Array:
    height, width = picture.shape[:2]
    column, row = np.clip(xy_px, 0, (width - 1, height - 1)).astype(np.intp).T
    return np.asarray(picture[row, column] / 255.0)


def _fit(matches: ColourMatches, given: tuple[Array, Array], free: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Fit gains (V, 3) and offsets (V, 3) that map each camera's colours to the scene's colours. Cameras for which the
    mask ``free`` (V,) is false keep the gains and offsets ``given``. If all cameras are free, or if the others have no
    correction, the mean correction of the free cameras is the identity."""
    gain, offset = (each.copy() for each in given)
    if not free.any() or not len(matches.first):
        return gain, offset
    has_gauge = not (free[matches.first] ^ free[matches.second]).any()
    weight = np.ones(len(matches.first))
    for _ in range(ITERATIONS):
        for channel in range(3):
            start = np.stack([gain[:, channel], offset[:, channel]], axis=1)
            gain[:, channel], offset[:, channel] = _solve(matches, channel, weight, start, free, has_gauge).T
        error = np.abs(_differences(matches, gain, offset)).max(axis=1)
        weight = 1 / (1 + np.square(error / (1.5 * np.median(error) + 1e-4)))
    return gain, offset


def _solve(
    matches: ColourMatches,
    channel: int,
    weight: Array,
    start: Array,
    free: NDArray[np.bool_],
    has_gauge: bool,
) -> Array:
    """Solve the weighted normal equations of one channel. The unknowns are the gains' differences from 1, and the
    offsets. Returns gains and offsets (V, 2).

    ``start`` (V, 2) contains the values of the cameras that are not ``free``. If ``has_gauge`` is true, the mean of the
    free cameras' unknowns is 0.
    """
    count = matches.cameras
    normal, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    ends = []
    for camera, rgb, sign in ((matches.first, matches.first_rgb, 1.0), (matches.second, matches.second_rgb, -1.0)):
        ends += [(2 * camera, sign * rgb[:, channel]), (2 * camera + 1, np.full(len(camera), sign))]
    difference = matches.first_rgb[:, channel] - matches.second_rgb[:, channel]
    for rows, left in ends:
        np.add.at(right, rows, -weight * left * difference)
        for columns, other in ends:
            np.add.at(normal, (rows, columns), weight * left * other)
    normal[np.arange(0, 2 * count, 2), np.arange(0, 2 * count, 2)] += PRIOR
    normal[np.arange(1, 2 * count, 2), np.arange(1, 2 * count, 2)] += OFFSET_PRIOR
    identity = np.array([1.0, 0.0])
    known = start - identity
    unknown = np.repeat(free, 2)
    right -= normal[:, ~unknown] @ known[~free].ravel()
    if has_gauge:
        for parity in (0, 1):
            mean = (unknown & (np.arange(2 * count) % 2 == parity)).astype(np.float64)
            normal += len(weight) * np.outer(mean, mean)
    known[free] = np.linalg.solve(normal[np.ix_(unknown, unknown)], right[unknown]).reshape(-1, 2)
    return np.asarray(known + identity)


def _differences(matches: ColourMatches, gain: Array, offset: Array) -> Array:
    """Return the differences (M, 3) between the corrected colours of matching points."""
    first = gain[matches.first] * matches.first_rgb + offset[matches.first]
    return np.asarray(first - gain[matches.second] * matches.second_rgb - offset[matches.second])
