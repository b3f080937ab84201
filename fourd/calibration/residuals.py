"""How well a calibration agrees with the pictures: distances of matched points from their epipolar lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fourd.calibration.matching import Features, Matches, features, match, supported, undistorted
from fourd.cameras import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Pair = tuple[int, int]

ALL_PAIRS = 8
NEIGHBOURS = 6
LEAST_MATCHES = 8
WORST_PX = 3.0
WORST_RATIO = 4.0
LEAST_PAIRS = 2
BAD_SHARE = 0.75
"""Of a bad camera's pairs that disagree, at least."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Distances of matches from their epipolar lines, in pixels of the pictures.

    Attributes:
        pairs: median distance by pair (i, j), i < j; only pairs with enough matches.
        counts: matches that were used, by pair that was tried.
        cameras: residual of each camera by itself, where pairs hold r_ij^2 = r_i^2 + r_j^2; None without a pair.
        bad: cameras that disagree with the others, ascending; see :func:`bad_cameras`.
    """

    pairs: dict[Pair, float]
    counts: dict[Pair, int]
    cameras: tuple[float | None, ...]
    bad: tuple[int, ...]


def epipolar_residuals(
    pictures: Sequence[Picture], cameras: Sequence[Camera], *, most_features: int = 4000
) -> Residuals:
    """Match pictures of one moment and tell how far the matches are from the cameras' epipolar lines.

    Args:
        pictures: an RGB picture (H, W, 3) of each camera, of its size.
        cameras: lenses of the pictures as they are: with distortion, or pinholes of undistorted pictures.
        most_features: in each picture.

    Returns:
        Residuals; wrong matches were dropped by geometry that was fitted to the matches alone
        (:func:`fourd.calibration.matching.supported`), so a wrong calibration does not hide behind its matches.

    Raises:
        ValueError: when a picture is not of its camera's size.
    """
    return residuals_of(matched_pairs(pictures, cameras, most_features=most_features), cameras)


def matched_pairs(
    pictures: Sequence[Picture], cameras: Sequence[Camera], *, most_features: int = 4000
) -> dict[Pair, Matches]:
    """Supported matches of the pairs that :func:`likely_pairs` names; arguments as epipolar_residuals.

    Matches of several frames may be joined before they are scored: ``a[pair].joined(b[pair])``.
    """
    for index, (picture, camera) in enumerate(zip(pictures, cameras, strict=True)):
        if picture.shape != (camera.height, camera.width, 3):
            raise ValueError(
                f"pictures[{index}]: expected {camera.height} x {camera.width} x 3, as the camera has, "
                f"got {' x '.join(map(str, picture.shape))}"
            )
    found: list[Features] = [features(picture, most_features) for picture in pictures]
    pairs: dict[Pair, Matches] = {}
    for i, j in likely_pairs(cameras):
        matches = match(found[i], found[j])
        straight = Matches(undistorted(cameras[i], matches.first_px), undistorted(cameras[j], matches.second_px))
        kept = supported(straight, cameras[j].width, cameras[j].height)
        pairs[i, j] = Matches(matches.first_px[kept], matches.second_px[kept])
    return pairs


def likely_pairs(cameras: Sequence[Camera]) -> list[Pair]:
    """Pairs (i, j), i < j, whose pictures may look alike: all of up to 8 cameras, else each with 6 neighbours.

    Neighbours are those whose viewing direction differs least, and of these the nearest in place.
    """
    count = len(cameras)
    if count <= ALL_PAIRS:
        return list(combinations(range(count), 2))
    centres, forwards = (
        np.stack([camera.centre for camera in cameras]),
        np.stack([camera.forward for camera in cameras]),
    )
    turn = np.arccos(np.clip(forwards @ forwards.T, -1, 1))
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    cost = turn + 0.1 * apart / max(float(np.median(apart)), 1e-12) + np.diag(np.full(count, np.inf))
    nearest = np.argsort(cost, axis=1, kind="stable")[:, :NEIGHBOURS]
    return sorted({(min(i, int(j)), max(i, int(j))) for i in range(count) for j in nearest[i]})


def residuals_of(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> Residuals:
    """Score a calibration by matches in the pixels of the cameras' pictures; see epipolar_residuals."""
    counts = {pair: len(found) for pair, found in matches.items()}
    pairs = {
        (i, j): float(np.median(np.abs(epipolar_distances(found, cameras[i], cameras[j]))))
        for (i, j), found in matches.items()
        if len(found) >= LEAST_MATCHES
    }
    return Residuals(pairs, counts, _blame(pairs, counts, len(cameras)), bad_cameras(pairs))


def epipolar_distances(matches: Matches, first: Camera, second: Camera) -> Array:
    """(M,) distance of each match from its epipolar lines in pixels, the mean of both pictures', signed as one.

    Cameras at one place have no epipolar lines: all distances are 0.
    """
    rotation = second.rotation @ first.rotation.T
    shift = second.translation - rotation @ first.translation
    length = float(np.linalg.norm(shift))
    if length < 1e-9 * max(1.0, float(np.linalg.norm(first.centre))):
        return np.zeros(len(matches))
    x, y, z = shift / length
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    fundamental = np.linalg.inv(second.intrinsics).T @ essential @ np.linalg.inv(first.intrinsics)
    here, there = (
        np.column_stack([undistorted(camera, xy), np.ones(len(xy))])
        for camera, xy in ((first, matches.first_px), (second, matches.second_px))
    )
    lines_there, lines_here = here @ fundamental.T, there @ fundamental
    error = (there * lines_there).sum(axis=1)
    slopes = [np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12) for lines in (lines_there, lines_here)]
    return np.asarray(0.5 * (error / slopes[0] + error / slopes[1]), np.float64)


def bad_cameras(pairs: Mapping[Pair, float], *, worst_px: float = WORST_PX) -> tuple[int, ...]:
    """Cameras that disagree with cameras that agree among each other, ascending.

    A pair disagrees when its median is above ``worst_px`` and above 4 times the median of the
    better half of all pairs. A camera is bad when it has at least 2 pairs, 3 in 4 of them or
    more disagree, and at least 2 of the partners there have a pair elsewhere that agrees. So
    two cameras alone are never accused, and neither is any where all disagree: then something
    common to all is wrong.
    """
    if not pairs:
        return ()
    better = np.sort(list(pairs.values()))[: (len(pairs) + 1) // 2]
    limit = max(worst_px, WORST_RATIO * float(np.median(better)))
    bad: list[int] = []
    for camera in sorted({index for pair in pairs for index in pair}):
        mine = {pair for pair in pairs if camera in pair}
        disagree = [pair for pair in mine if pairs[pair] > limit]
        partners = {index for pair in disagree for index in pair} - {camera}
        sound = {index for index in partners if any(index in p and pairs[p] <= limit for p in pairs if p not in mine)}
        if len(mine) >= LEAST_PAIRS and len(disagree) >= BAD_SHARE * len(mine) and len(sound) >= LEAST_PAIRS:
            bad.append(camera)
    return tuple(bad)


def _blame(pairs: Mapping[Pair, float], counts: Mapping[Pair, int], cameras: int) -> tuple[float | None, ...]:
    """Each camera's share r_i >= 0 of r_ij^2 = r_i^2 + r_j^2: least absolute deviations by reweighting."""
    if not pairs:
        return (None,) * cameras
    design = np.zeros((len(pairs), cameras))
    for row, pair in enumerate(pairs):
        design[row, list(pair)] = 1.0
    squares = np.array(list(pairs.values())) ** 2
    trust = np.sqrt([min(counts[pair], 100) for pair in pairs])
    weights, solution = trust, np.zeros(cameras)
    for _ in range(20):
        solution, _ = nnls(weights[:, None] * design, weights * squares)
        error = np.abs(design @ solution - squares)
        weights = trust / np.sqrt(np.maximum(error, 1e-3 * max(float(squares.max()), 1e-12)))
    return tuple(float(np.sqrt(solution[i])) if design[:, i].any() else None for i in range(cameras))
