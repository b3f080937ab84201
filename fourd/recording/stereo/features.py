"""Features of images, their matches, and fundamental matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

RATIO_TEST_THRESHOLD = 0.8
"""Maximum ratio d1 / d2 in Lowe's ratio test (IJCV 2004): d1 and d2 are the distances to the nearest and to the second
nearest descriptor."""
MAX_EXHAUSTIVE_CAMERAS = 8
"""Maximum number of cameras for which all pairs are matched."""
MIN_COSINE = 0.4
"""Minimum cosine of the angle between the viewing directions of two cameras that are matched."""


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one image.

    Attributes:
        xy_px: (N, 2) positions in pixels; the first pixel's centre is at (0.5, 0.5).
        descriptors: (N, 128) descriptors of unit length.
    """

    xy_px: Array
    descriptors: Floats


def pairs_to_match(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Select the camera pairs to match.

    If there are at most 8 cameras, all pairs are matched. Otherwise, two cameras are matched only if their viewing
    directions differ by less than 66 degrees.
    """
    return [
        (i, j)
        for i, j in combinations(range(len(cameras)), 2)
        if len(cameras) <= MAX_EXHAUSTIVE_CAMERAS or cameras[i].forward @ cameras[j].forward > MIN_COSINE
    ]


def match_features(first: Features, second: Features, ratio: float = RATIO_TEST_THRESHOLD) -> NDArray[np.intp]:
    """Find index pairs (M, 2) of features that are mutual nearest neighbours and pass Lowe's ratio test."""
    if min(len(first.xy_px), len(second.xy_px)) < 2:
        return np.zeros((0, 2), np.intp)
    return match_similar(first.descriptors @ second.descriptors.T, ratio)


def match_similar(similarity: Floats, ratio: float, min_similarity: float = -1.0) -> NDArray[np.intp]:
    """Find index pairs (M, 2) of features that are mutual nearest neighbours and pass Lowe's ratio test.

    Args:
        similarity: (N1, N2) cosine similarity of each feature of the first and each of the second image. Each image has
            at least two features.
        ratio: largest ratio of the distances to the nearest and to the second nearest descriptor.
        min_similarity: matches are more similar than this.
    """
    best = similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[best] == np.arange(len(best))
    nearest = np.partition(similarity, -2, axis=1)[:, -2:]
    distance = np.sqrt(np.maximum(2 - 2 * nearest, 0))
    kept = np.flatnonzero(mutual & (nearest[:, 1] > min_similarity) & (distance[:, 1] < ratio * distance[:, 0]))
    return np.column_stack([kept, best[kept]])


def fundamental_matrix(camera: Camera, other: Camera) -> Array:
    """Compute the (3, 3) fundamental matrix F. If x is a pixel of ``camera``, F @ x is its epipolar line in the image
    of ``other``."""
    rotation = other.rotation @ camera.rotation.T
    x, y, z = other.translation - rotation @ camera.translation
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    return np.asarray(np.linalg.inv(other.intrinsics).T @ essential @ np.linalg.inv(camera.intrinsics), np.float64)
