"""Epipolar residuals: distances of matched points from their epipolar lines under a calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fourd.base.cameras import Camera
from fourd.recording.calibration.matching import (
    Matches,
    extract_features,
    match_positions,
    undistort_points,
    verify_matches,
)

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Pair = tuple[int, int]

ALL_PAIRS_CAMERAS = 8
NEIGHBOURS = 6
MIN_MATCHES = 8
MAX_GOOD_PX = 3.0
MAX_GOOD_RATIO = 4.0
MIN_PAIRS = 2
MIN_BAD_SHARE = 0.75
"""A camera is bad only if it disagrees with the other camera in at least this fraction of its pairs; see
:func:`find_bad_cameras`."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Distances of matches from their epipolar lines, in pixels.

    Attributes:
        pairs: median distance r_ij of each camera pair (i, j), i < j, with at least 8 matches.
        counts: number of matches of each pair.
        cameras: residual r_i of each camera i, fitted to r_ij^2 = r_i^2 + r_j^2, or None for a camera without enough
            matches.
        bad: ascending indices of the cameras that disagree with the others; see :func:`find_bad_cameras`.
    """

    pairs: dict[Pair, float]
    counts: dict[Pair, int]
    cameras: tuple[float | None, ...]
    bad: tuple[int, ...]


def epipolar_residuals(
    pictures: Sequence[Picture], cameras: Sequence[Camera], *, max_features: int = 4000
) -> Residuals:
    """Match the images of one frame and compute the distances of the matches from their epipolar lines.

    Args:
        pictures: one RGB image (H, W, 3) per camera, of the camera's size.
        cameras: cameras of the images; they must have distortion coefficients if the images are distorted, and none if
            the images are undistorted.
        max_features: maximum number of features per image.

    Returns:
        The residuals. The removal of wrong matches does not use the cameras' poses
        (:func:`fourd.recording.calibration.matching.inlier_mask`), so the residuals show errors of the poses.

    Raises:
        ValueError: if an image does not have its camera's size.
    """
    return compute_residuals(match_pairs(pictures, cameras, max_features=max_features), cameras)


def match_pairs(
    pictures: Sequence[Picture],
    cameras: Sequence[Camera],
    *,
    max_features: int = 4000,
    pairs: Sequence[Pair] | None = None,
) -> dict[Pair, Matches]:
    """Match features between the images of camera pairs, and keep the matches that fit a common two-view geometry.

    Args:
        pictures: one RGB image (H, W, 3) per camera, of the camera's size.
        cameras: cameras of the images.
        max_features: maximum number of features per image.
        pairs: the camera pairs (i, j), i < j, or None for those of :func:`select_pairs`.

    Raises:
        ValueError: if an image does not have its camera's size.
    """
    for index, (picture, camera) in enumerate(zip(pictures, cameras, strict=True)):
        if picture.shape != (camera.height, camera.width, 3):
            raise ValueError(
                f"pictures[{index}]: expected {camera.height} x {camera.width} x 3 like the camera, "
                f"got {' x '.join(map(str, picture.shape))}"
            )
    chosen = select_pairs(cameras) if pairs is None else pairs
    used = {index for pair in chosen for index in pair}
    features = {index: extract_features(pictures[index], max_features) for index in sorted(used)}
    return {
        (i, j): verify_matches(match_positions(features[i], features[j]), cameras[i], cameras[j]) for i, j in chosen
    }


def select_pairs(cameras: Sequence[Camera]) -> list[Pair]:
    """Select the camera pairs (i, j), i < j, whose images are matched.

    For up to 8 cameras, all pairs are matched. For more cameras, each camera is paired with the 6 cameras of smallest
    cost. The cost is the angle between the viewing directions in radians, plus a small term for the distance between
    the camera centres.
    """
    count = len(cameras)
    if count <= ALL_PAIRS_CAMERAS:
        return list(combinations(range(count), 2))
    centres, forwards = (
        np.stack([camera.centre for camera in cameras]),
        np.stack([camera.forward for camera in cameras]),
    )
    angles = np.arccos(np.clip(forwards @ forwards.T, -1, 1))
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    cost = angles + 0.1 * distances / max(float(np.median(distances)), 1e-12) + np.diag(np.full(count, np.inf))
    nearest = np.argsort(cost, axis=1, kind="stable")[:, :NEIGHBOURS]
    return sorted({(min(i, int(j)), max(i, int(j))) for i in range(count) for j in nearest[i]})


def compute_residuals(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> Residuals:
    """Compute the epipolar residuals of ``matches``, whose positions are in pixels of the distorted images."""
    counts = {pair: len(found) for pair, found in matches.items()}
    pairs = {
        (i, j): float(np.median(np.abs(epipolar_distances(found, cameras[i], cameras[j]))))
        for (i, j), found in matches.items()
        if len(found) >= MIN_MATCHES
    }
    return Residuals(pairs, counts, _camera_residuals(pairs, counts, len(cameras)), find_bad_cameras(pairs))


def epipolar_distances(matches: Matches, first: Camera, second: Camera) -> Array:
    """Return the signed distances (M,), in pixels, of matches from their epipolar lines, averaged over the two images.

    Two cameras with the same centre have no epipolar lines; for them, the function returns 0 for each match.
    """
    rotation = second.rotation @ first.rotation.T
    shift = second.translation - rotation @ first.translation
    length = float(np.linalg.norm(shift))
    if length < 1e-9 * max(1.0, float(np.linalg.norm(first.centre))):
        return np.zeros(len(matches))
    x, y, z = shift / length
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    fundamental = np.linalg.inv(second.intrinsics).T @ essential @ np.linalg.inv(first.intrinsics)
    first_xyw, second_xyw = (
        np.column_stack([undistort_points(camera, xy), np.ones(len(xy))])
        for camera, xy in ((first, matches.first_px), (second, matches.second_px))
    )
    second_lines, first_lines = first_xyw @ fundamental.T, second_xyw @ fundamental
    error = (second_xyw * second_lines).sum(axis=1)
    norms = [np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12) for lines in (second_lines, first_lines)]
    return np.asarray(0.5 * (error / norms[0] + error / norms[1]), np.float64)


def find_bad_cameras(pairs: Mapping[Pair, float], *, max_px: float = MAX_GOOD_PX) -> tuple[int, ...]:
    """Find the cameras whose pairs have large residuals, although the other cameras agree with each other.

    ``pairs`` contains the residual of each camera pair, which is the median over the pair's matches. Let m be the
    median residual of the better half of the pairs, that is, the half with the smaller residuals. The two cameras of a
    pair disagree if the pair's residual exceeds both ``max_px`` and 4 * m; otherwise, they agree.

    A camera is bad if it meets all of these conditions:
    - the camera belongs to at least 2 pairs;
    - in at least 75% of its pairs, the camera disagrees with the other camera;
    - it disagrees with at least 2 cameras that are probably correct, because each of them agrees with a third camera.

    If there are only two cameras or all pairs disagree, the residuals do not show which camera is wrong, so no camera
    is bad.

    Returns:
        The indices of the bad cameras in ascending order.
    """
    if not pairs:
        return ()
    better = np.sort(list(pairs.values()))[: (len(pairs) + 1) // 2]
    limit = max(max_px, MAX_GOOD_RATIO * float(np.median(better)))
    bad: list[int] = []
    for camera in sorted({index for pair in pairs for index in pair}):
        own = {pair for pair in pairs if camera in pair}
        disagree = [pair for pair in own if pairs[pair] > limit]
        partners = {index for pair in disagree for index in pair} - {camera}
        sound = {index for index in partners if any(index in p and pairs[p] <= limit for p in pairs if p not in own)}
        if len(own) >= MIN_PAIRS and len(disagree) >= MIN_BAD_SHARE * len(own) and len(sound) >= MIN_PAIRS:
            bad.append(camera)
    return tuple(bad)


def _camera_residuals(
    pairs: Mapping[Pair, float], counts: Mapping[Pair, int], cameras: int
) -> tuple[float | None, ...]:
    """Fit the residuals r_i >= 0 of the cameras to the residuals r_ij of the pairs: r_ij^2 = r_i^2 + r_j^2.

    By iteratively reweighted least squares, the fit minimises the sum of ``min(n, 100) * |r_i^2 + r_j^2 - r_ij^2|``
    over the pairs, where n is the pair's number of matches.
    """
    if not pairs:
        return (None,) * cameras
    design = np.zeros((len(pairs), cameras))
    for row, pair in enumerate(pairs):
        design[row, list(pair)] = 1.0
    squares = np.array(list(pairs.values())) ** 2
    base_weights = np.sqrt([min(counts[pair], 100) for pair in pairs])
    weights, solution = base_weights, np.zeros(cameras)
    for _ in range(20):
        try:
            solution, _ = nnls(weights[:, None] * design, weights * squares)
        except RuntimeError:
            # The iteration of SciPy can fail to end. The previous solution is then the result.
            break
        error = np.abs(design @ solution - squares)
        weights = base_weights / np.sqrt(np.maximum(error, 1e-3 * max(float(squares.max()), 1e-12)))
    return tuple(float(np.sqrt(solution[i])) if design[:, i].any() else None for i in range(cameras))
