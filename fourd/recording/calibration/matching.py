"""Feature matches between two images, verified by two-view geometry.

Verification does not use camera poses. Instead, homographies and a fundamental matrix are fitted to the matches. The
inliers of a model are kept if there are more of them than random matches would give.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from fourd.base.cameras import Camera
from fourd.recording.stereo.features import RATIO_TEST_THRESHOLD, Features, match_features

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

MAX_PLANES = 3
TOLERANCE_PX = 2.0
UNDISTORT_ITERATIONS = 20
MAX_FALSE_ALARMS = 1e-4
"""Maximum number of false alarms (NFA) of an accepted model.

The NFA of a model is the expected number of models with at least as many inliers, if all matches are random.
"""


@dataclass(frozen=True, eq=False)
class Matches:
    """Corresponding points of two images.

    Attributes:
        first_px: (M, 2) positions in pixels of the first distorted image.
        second_px: (M, 2) positions in pixels of the second distorted image.
    """

    first_px: Array
    second_px: Array

    def __len__(self) -> int:
        return len(self.first_px)

    def concatenate(self, other: Matches) -> Matches:
        """Append the matches of another frame of the same two cameras."""
        return Matches(np.vstack([self.first_px, other.first_px]), np.vstack([self.second_px, other.second_px]))


def extract_features(picture: Picture, max_features: int = 4000) -> Features:
    """Extract the ``max_features`` strongest SIFT features of an RGB image (H, W, 3).

    Descriptors are square roots of L1-normalised SIFT descriptors (RootSIFT, Arandjelovic and Zisserman, CVPR 2012).
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    points, descriptors = cv2.SIFT.create(max_features, contrastThreshold=0.02).detectAndCompute(grey, None)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    xy = np.array([point.pt for point in points], np.float64) + 0.5
    sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
    return Features(xy, np.sqrt(descriptors / sums).astype(np.float32))


def match_positions(first: Features, second: Features, ratio: float = RATIO_TEST_THRESHOLD) -> Matches:
    """Match features that are mutual nearest neighbours and pass Lowe's ratio test.

    SIFT returns one feature per dominant orientation, so several features may have the same position. Only one match
    per position is kept, because duplicates are not independent evidence.
    """
    rows = match_features(first, second, ratio)
    first_px, second_px = first.xy_px[rows[:, 0]], second.xy_px[rows[:, 1]]
    kept = np.sort(np.unique(np.round(np.hstack([first_px, second_px])), axis=0, return_index=True)[1])
    return Matches(first_px[kept], second_px[kept])


def verify_matches(matches: Matches, first: Camera, second: Camera, tolerance_px: float = TOLERANCE_PX) -> Matches:
    """Keep the matches that fit a common two-view geometry (see :func:`inlier_mask`).

    Points are undistorted with the cameras' intrinsics and distortion; the poses are not used. No matches are kept if
    no geometry has significantly more inliers than random matches would give.
    """
    straight = Matches(undistort_points(first, matches.first_px), undistort_points(second, matches.second_px))
    kept = inlier_mask(straight, second.width, second.height, tolerance_px)
    return Matches(matches.first_px[kept], matches.second_px[kept])


def inlier_mask(matches: Matches, width: int, height: int, tolerance_px: float = TOLERANCE_PX) -> NDArray[np.bool_]:
    """Return the mask (M,) of the undistorted matches that fit a common two-view geometry.

    Up to 3 homographies, one per plane in the scene, are fitted first, then a fundamental matrix. Each model is fitted
    with MAGSAC (Barath et al., CVPR 2020). A model is accepted if random matches are unlikely to give as many inliers
    (a contrario test, Moisan and Stival, IJCV 2004). If no model is accepted, the mask is False everywhere.

    Matches of points on one plane do not determine the fundamental matrix: there is always a fundamental matrix that
    fits all of them and any two further matches, even wrong ones. Therefore, if a homography was accepted, the test of
    the fundamental matrix ignores the inliers of all accepted homographies. Of the remaining inliers, two are no
    evidence, because any two matches would fit.

    Args:
        matches: M matches in pixels of the undistorted images.
        width: width of the second image in pixels.
        height: height of the second image in pixels.
        tolerance_px: maximum residual of inliers in pixels.
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
    try:
        if planar:
            _, mask = cv2.findHomography(first, second, cv2.USAC_MAGSAC, tolerance_px, maxIters=5000, confidence=0.999)
        else:
            _, mask = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, tolerance_px, 0.999, 10000)
    except cv2.error:
        # OpenCV 5 raises an assertion instead of returning no model if every sample of the matches is degenerate, as
        # happens with a few wrong matches.
        return which[:0]
    return which[:0] if mask is None else which[mask.ravel() > 0]


def _beats_chance(count: int, inliers: int, sample_size: int, probability: float) -> bool:
    """Return whether random matches are unlikely to give a model with ``inliers`` inliers among ``count`` matches.

    The ``sample_size`` matches that define a model always fit the model. ``probability`` is the probability that a
    random match fits the model.
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
    """Map pixels (N, 2) of the camera's distorted image to pixels of a pinhole camera with the same intrinsics.

    The method is fixed-point iteration, which converges for all lenses except fisheye lenses.
    """
    if camera.distortion is None or not len(xy_px):
        return xy_px
    straight = xy_px
    for _ in range(UNDISTORT_ITERATIONS):
        straight = straight + (xy_px - distort_points(camera, straight))
    return straight


def distort_points(camera: Camera, xy_px: Array) -> Array:
    """Map pixels (N, 2) of a pinhole camera with the same intrinsics to pixels of the camera's distorted image."""
    if camera.distortion is None or not len(xy_px):
        return xy_px
    rays = np.column_stack([xy_px, np.ones(len(xy_px))]) @ np.linalg.inv(camera.intrinsics).T
    pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.intrinsics, camera.distortion)
    return np.asarray(pixels[:, 0], np.float64)
