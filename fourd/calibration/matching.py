"""Points that two cameras' pictures both show, and which of them the geometry of two views supports.

No camera's pose is taken at its word: matched points are kept when a plane or a fundamental matrix
that was fitted to the matches themselves explains more of them than chance would.
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

MOST_PLANES = 3
TOLERANCE_PX = 2.0
INVERSE_STEPS = 20
FALSE_ALARMS = 1e-4
"""Expected number of models as good as the one found, were all matches chance; fewer count as support."""


@dataclass(frozen=True, eq=False)
class Features:
    """Places xy_px (N, 2), (0.5, 0.5) being the first pixel's centre, and RootSIFT descriptors (N, 128) float32."""

    xy_px: Array
    descriptors: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Matches:
    """Points that two pictures show: first_px and second_px (M, 2), in the pixels of the pictures as they are."""

    first_px: Array
    second_px: Array

    def __len__(self) -> int:
        return len(self.first_px)

    def joined(self, other: Matches) -> Matches:
        """These matches and those of another frame of the same two cameras."""
        return Matches(np.vstack([self.first_px, other.first_px]), np.vstack([self.second_px, other.second_px]))


def features(picture: Picture, most: int = 4000) -> Features:
    """The ``most`` strongest SIFT features of an RGB picture (H, W, 3), one a place.

    Descriptors are square roots of L1-normalised SIFT (RootSIFT: Arandjelovic and Zisserman, CVPR 2012).
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    points, descriptors = cv2.SIFT.create(most, contrastThreshold=0.02).detectAndCompute(grey, None)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    xy = np.array([point.pt for point in points], np.float64) + 0.5
    sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
    return Features(xy, np.sqrt(descriptors / sums).astype(np.float32))


def match(first: Features, second: Features, ratio: float = 0.8) -> Matches:
    """Mutually nearest descriptors that are nearer than ``ratio`` times the second nearest; one match a place.

    A feature that has several orientations would count several times as evidence; it counts once.
    """
    if len(first.xy_px) < 2 or len(second.xy_px) < 2:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    likeness = first.descriptors @ second.descriptors.T
    best = likeness.argmax(axis=1)
    mutual = likeness.argmax(axis=0)[best] == np.arange(len(best))
    nearest = np.sqrt(np.maximum(2 - 2 * np.partition(likeness, -2, axis=1)[:, -2:], 1e-12))
    kept = np.flatnonzero(mutual & (nearest[:, 1] < ratio * nearest[:, 0]))
    places = np.round(np.hstack([first.xy_px[kept], second.xy_px[best[kept]]]))
    kept = kept[np.sort(np.unique(places, axis=0, return_index=True)[1])]
    return Matches(first.xy_px[kept], second.xy_px[best[kept]])


def supported(matches: Matches, width: int, height: int, tolerance_px: float = TOLERANCE_PX) -> NDArray[np.bool_]:
    """(M,) which matches a common geometry supports; all False where no model beats chance.

    Planes (homographies) are sought one after the other, then a fundamental matrix, each with
    MAGSAC (Barath et al., CVPR 2020). A model counts when its number of inliers is unlikely by
    chance (a contrario: Moisan and Stival, IJCV 2004). A fundamental matrix that was fitted to a
    planar scene is degenerate: next to a plane it needs support by matches off the plane, of which
    any two would fit. ``width`` and ``height`` are of the second picture, whose matches must be undistorted.
    """
    count = len(matches)
    on_planes = np.zeros(count, bool)
    area = float(width * height)
    for _ in range(MOST_PLANES):
        rest = np.flatnonzero(~on_planes)
        inliers = _inliers(matches, rest, tolerance_px, planar=True)
        if not _beats_chance(len(rest), len(inliers), 4, np.pi * tolerance_px**2 / area):
            break
        on_planes[inliers] = True
    band = 2 * tolerance_px * float(np.hypot(width, height)) / area
    whole = _inliers(matches, np.arange(count), tolerance_px, planar=False)
    off_plane = whole[~on_planes[whole]]
    free = 2 if on_planes.any() else 7
    if not _beats_chance(int((~on_planes).sum()), len(off_plane), free, band):
        return on_planes
    kept = np.zeros(count, bool)
    kept[whole] = True
    return kept


def _inliers(matches: Matches, which: NDArray[np.intp], tolerance_px: float, planar: bool) -> NDArray[np.intp]:
    if len(which) < 8:
        return which[:0]
    first, second = matches.first_px[which], matches.second_px[which]
    cv2.setRNGSeed(0)
    if planar:
        _, mask = cv2.findHomography(first, second, cv2.USAC_MAGSAC, tolerance_px, maxIters=5000, confidence=0.999)
    else:
        _, mask = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, tolerance_px, 0.999, 10000)
    return which[:0] if mask is None else which[mask.ravel() > 0]


def _beats_chance(count: int, inliers: int, free: int, share: float) -> bool:
    """Whether ``inliers`` of ``count``, beyond the ``free`` that any model fits, are too many for chance.

    ``share`` is the probability that a random match fits.
    """
    if inliers <= free + 3:
        return False
    expected = np.log(count) + _choices(count, inliers) + _choices(inliers, free) + (inliers - free) * np.log(share)
    return bool(expected < np.log(FALSE_ALARMS))


def _choices(count: int, taken: int) -> float:
    """Logarithm of the binomial coefficient."""
    return float(gammaln(count + 1) - gammaln(taken + 1) - gammaln(count - taken + 1))


def undistorted(camera: Camera, xy_px: Array) -> Array:
    """(N, 2) places in an ideal pinhole's picture with the same K, of places in the camera's picture.

    Solved step by step, which ends well for lenses that are no fisheyes.
    """
    if camera.distortion is None or not len(xy_px):
        return xy_px
    straight = xy_px
    for _ in range(INVERSE_STEPS):
        straight = straight + (xy_px - distorted(camera, straight))
    return straight


def distorted(camera: Camera, xy_px: Array) -> Array:
    """(N, 2) places in the camera's picture, of an ideal pinhole's with the same K."""
    if camera.distortion is None or not len(xy_px):
        return xy_px
    rays = np.column_stack([xy_px, np.ones(len(xy_px))]) @ np.linalg.inv(camera.intrinsics).T
    pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.intrinsics, camera.distortion)
    return np.asarray(pixels[:, 0], np.float64)
