"""Feature matches between two pictures, verified by the geometry of two views.

Verification uses no camera pose: matches are kept when a homography or a fundamental matrix that was fitted to the
matches themselves has more inliers than chance explains.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from fourd.cameras import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

MAX_PLANES = 3
TOLERANCE_PX = 2.0
UNDISTORT_ITERATIONS = 20
MAX_FALSE_ALARMS = 1e-4
"""Expected number of equally good models if all matches were random; a model below this is accepted."""


@dataclass(frozen=True, eq=False)
class Features:
    """Positions xy_px (N, 2), (0.5, 0.5) at the first pixel's centre, and RootSIFT descriptors (N, 128) float32."""

    xy_px: Array
    descriptors: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Matches:
    """Corresponding points of two pictures, first_px and second_px (M, 2), in pixels of the distorted pictures."""

    first_px: Array
    second_px: Array

    def __len__(self) -> int:
        return len(self.first_px)

    def concatenate(self, other: Matches) -> Matches:
        """These matches followed by those of another frame of the same two cameras."""
        return Matches(np.vstack([self.first_px, other.first_px]), np.vstack([self.second_px, other.second_px]))


def extract_features(picture: Picture, max_features: int = 4000) -> Features:
    """The ``max_features`` strongest SIFT features of an RGB picture (H, W, 3).

    Descriptors are square roots of L1-normalised SIFT (RootSIFT: Arandjelovic and Zisserman, CVPR 2012).
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    points, descriptors = cv2.SIFT.create(max_features, contrastThreshold=0.02).detectAndCompute(grey, None)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    xy = np.array([point.pt for point in points], np.float64) + 0.5
    sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
    return Features(xy, np.sqrt(descriptors / sums).astype(np.float32))


def match_features(first: Features, second: Features, ratio: float = 0.8) -> Matches:
    """Mutual nearest neighbours that pass Lowe's ratio test.

    SIFT detects a feature with several orientations several times at one position; of such duplicates one match is
    kept, since they are no independent evidence.
    """
    if len(first.xy_px) < 2 or len(second.xy_px) < 2:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    similarity = first.descriptors @ second.descriptors.T
    best = similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[best] == np.arange(len(best))
    nearest = np.sqrt(np.maximum(2 - 2 * np.partition(similarity, -2, axis=1)[:, -2:], 1e-12))
    kept = np.flatnonzero(mutual & (nearest[:, 1] < ratio * nearest[:, 0]))
    positions = np.round(np.hstack([first.xy_px[kept], second.xy_px[best[kept]]]))
    kept = kept[np.sort(np.unique(positions, axis=0, return_index=True)[1])]
    return Matches(first.xy_px[kept], second.xy_px[best[kept]])


def verify_matches(matches: Matches, first: Camera, second: Camera, tolerance_px: float = TOLERANCE_PX) -> Matches:
    """The matches that fit a common two-view geometry; none where no model beats chance.

    The cameras' intrinsics and distortion straighten the points; their poses are not used. See :func:`inlier_mask`.
    """
    straight = Matches(undistort_points(first, matches.first_px), undistort_points(second, matches.second_px))
    kept = inlier_mask(straight, second.width, second.height, tolerance_px)
    return Matches(matches.first_px[kept], matches.second_px[kept])


def inlier_mask(matches: Matches, width: int, height: int, tolerance_px: float = TOLERANCE_PX) -> NDArray[np.bool_]:
    """(M,) whether each undistorted match fits a common two-view geometry; all False where no model beats chance.

    Fits up to 3 homographies one after the other, then a fundamental matrix, each with MAGSAC (Barath et al., CVPR
    2020). A model is accepted when its number of inliers is unlikely by chance (a contrario: Moisan and Stival, IJCV
    2004). A fundamental matrix that was fitted to a planar scene is degenerate and fits any two matches off the plane:
    beside a homography it is accepted only for its inliers off the plane, beyond 2. ``width`` and ``height`` are of
    the second picture.
    """
    count = len(matches)
    on_planes = np.zeros(count, bool)
    area = float(width * height)
    for _ in range(MAX_PLANES):
        rest = np.flatnonzero(~on_planes)
        inliers = _fit_inliers(matches, rest, tolerance_px, planar=True)
        if not _beats_chance(len(rest), len(inliers), 4, np.pi * tolerance_px**2 / area):
            break
        on_planes[inliers] = True
    band = 2 * tolerance_px * float(np.hypot(width, height)) / area
    whole = _fit_inliers(matches, np.arange(count), tolerance_px, planar=False)
    off_plane = whole[~on_planes[whole]]
    sample_size = 2 if on_planes.any() else 7
    if not _beats_chance(int((~on_planes).sum()), len(off_plane), sample_size, band):
        return on_planes
    kept = np.zeros(count, bool)
    kept[whole] = True
    return kept


def _fit_inliers(matches: Matches, which: NDArray[np.intp], tolerance_px: float, planar: bool) -> NDArray[np.intp]:
    if len(which) < 8:
        return which[:0]
    first, second = matches.first_px[which], matches.second_px[which]
    cv2.setRNGSeed(0)
    if planar:
        _, mask = cv2.findHomography(first, second, cv2.USAC_MAGSAC, tolerance_px, maxIters=5000, confidence=0.999)
    else:
        _, mask = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, tolerance_px, 0.999, 10000)
    return which[:0] if mask is None else which[mask.ravel() > 0]


def _beats_chance(count: int, inliers: int, sample_size: int, probability: float) -> bool:
    """Whether ``inliers`` of ``count`` matches are too many for chance.

    Any model fits the ``sample_size`` matches that define it; ``probability`` is that of a random match to fit.
    """
    if inliers <= sample_size + 3:
        return False
    log_false_alarms = (
        np.log(count)
        + _log_binomial(count, inliers)
        + _log_binomial(inliers, sample_size)
        + (inliers - sample_size) * np.log(probability)
    )
    return bool(log_false_alarms < np.log(MAX_FALSE_ALARMS))


def _log_binomial(n: int, k: int) -> float:
    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))


def undistort_points(camera: Camera, xy_px: Array) -> Array:
    """(N, 2) pixels of a pinhole with the same K, from pixels of the camera's distorted picture.

    Fixed-point iteration, which converges for lenses other than fisheyes.
    """
    if camera.distortion is None or not len(xy_px):
        return xy_px
    straight = xy_px
    for _ in range(UNDISTORT_ITERATIONS):
        straight = straight + (xy_px - distort_points(camera, straight))
    return straight


def distort_points(camera: Camera, xy_px: Array) -> Array:
    """(N, 2) pixels of the camera's distorted picture, from pixels of a pinhole with the same K."""
    if camera.distortion is None or not len(xy_px):
        return xy_px
    rays = np.column_stack([xy_px, np.ones(len(xy_px))]) @ np.linalg.inv(camera.intrinsics).T
    pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.intrinsics, camera.distortion)
    return np.asarray(pixels[:, 0], np.float64)
