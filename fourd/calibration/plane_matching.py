"""Matches on a plane that cameras see from far apart, where features no longer look alike.

Each picture is drawn as seen from straight above the plane, by the calibration; small patches are
then sought near the place where the calibration puts them. The calibration decides what a patch
looks like and where the search begins, never where it ends: the residual is what the search finds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.calibration.matching import Matches, distorted
from fourd.cameras import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

HALF_PATCH = 24
LEAST_LIKENESS = 0.75
LEAST_LEAD = 0.12
"""By which the best place's correlation must lead over that of any other place."""
LEAST_FALL = 0.03
"""By which the correlation must fall within 3 pixels on all sides, else the patch slides along an edge."""
LEAST_CONTRAST = 6.0


@dataclass(frozen=True, eq=False)
class Patch:
    """A rectangle of a plane in the world.

    Attributes:
        corner: (3,) world point that the raster begins at.
        right, down: (3,) unit vectors across and down the raster, at right angles.
        width, height: of the rectangle, world units.
        resolution: pixels of the raster per world unit.
    """

    corner: Array
    right: Array
    down: Array
    width: float
    height: float
    resolution: float

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the raster in pixels."""
        return round(self.width * self.resolution), round(self.height * self.resolution)

    def to_picture(self, camera: Camera) -> Array:
        """(3, 3) homography from the raster's pixels to the ideal pinhole's, corners being integers in both."""
        K, R_camera_world = camera.intrinsics, camera.rotation
        step = 1 / self.resolution
        origin = R_camera_world @ self.corner + camera.translation
        axes = [step * R_camera_world @ self.right, step * R_camera_world @ self.down, origin]
        return np.asarray(K @ np.column_stack(axes), np.float64)


def flat_matches(
    first: Picture, second: Picture, lenses: tuple[Camera, Camera], patch: Patch, reach: int = 28
) -> Matches:
    """Matches of two RGB pictures (H, W, 3) of one moment, on and near the plane of ``patch``.

    Args:
        lenses: the two cameras; their distortion is honoured.
        reach: raster pixels by which the calibration may be wrong; beyond it nothing is found.

    Returns:
        Matches in the pictures' own (distorted) pixels. Corners of the first raster whose patch
        correlates with one place of the second, clearly best and sharp in all directions.
    """
    (flat, seen), (other, other_seen) = (
        _flattened(picture, lens, patch) for picture, lens in zip((first, second), lenses, strict=True)
    )
    margin = 2 * (HALF_PATCH + reach) + 1
    inside = cv2.erode(
        seen & other_seen, np.ones((margin, margin), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    even = cv2.createCLAHE(3.0, (8, 8)).apply(flat)
    corners = cv2.goodFeaturesToTrack(even, 400, 0.005, 8, mask=inside, blockSize=15)
    found = [] if corners is None else [_found(flat, other, int(x), int(y), reach) for x, y in corners[:, 0]]
    pairs = np.array([pair for pair in found if pair is not None]).reshape(-1, 4) + 0.5
    return Matches(
        *(_in_picture(lens, patch, xy) for lens, xy in zip(lenses, (pairs[:, :2], pairs[:, 2:]), strict=True))
    )


def _flattened(picture: Picture, lens: Camera, patch: Patch) -> tuple[Picture, Picture]:
    """The raster in grey, slightly smoothed, and 255 where the picture has content."""
    columns, rows = patch.size
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    to_ray = np.linalg.inv(lens.intrinsics) @ patch.to_picture(lens) @ half
    k = lens.intrinsics.copy()
    k[:2, 2] -= 0.5
    # OpenCV takes any invertible matrix for the new camera's and inverts it: a homography and the lens in one step.
    across, down = cv2.initUndistortRectifyMap(
        k, lens.distortion, None, np.linalg.inv(to_ray), patch.size, cv2.CV_32FC1
    )
    place = np.stack([across, down], axis=2)
    depth = to_ray[2, 0] * np.arange(columns) + (to_ray[2, 1] * np.arange(rows) + to_ray[2, 2])[:, None]
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    flat = cv2.remap(grey, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
    height, width = grey.shape
    seen = (depth > 0) & (place >= 0).all(axis=2) & (place[..., 0] <= width - 1) & (place[..., 1] <= height - 1)
    return np.asarray(cv2.GaussianBlur(flat, (0, 0), 1.0), np.uint8), np.where(seen, 255, 0).astype(np.uint8)


def _in_picture(lens: Camera, patch: Patch, raster_px: Array) -> Array:
    place = np.column_stack([raster_px, np.ones(len(raster_px))]) @ patch.to_picture(lens).T
    return distorted(lens, place[:, :2] / place[:, 2:])


def _found(flat: Picture, other: Picture, x: int, y: int, reach: int) -> tuple[float, float, float, float] | None:
    """(x, y) and the place in the other raster, to a fraction of a pixel; None where there is no clear one."""
    wide = HALF_PATCH + reach
    template = flat[y - HALF_PATCH : y + HALF_PATCH + 1, x - HALF_PATCH : x + HALF_PATCH + 1]
    if template.std() < LEAST_CONTRAST:
        return None
    likeness = cv2.matchTemplate(
        other[y - wide : y + wide + 1, x - wide : x + wide + 1], template, cv2.TM_CCOEFF_NORMED
    )
    _, peak, _, (j, i) = cv2.minMaxLoc(likeness)
    if peak < LEAST_LIKENESS or not (3 <= i < 2 * reach - 2 and 3 <= j < 2 * reach - 2):
        return None
    around = likeness[i - 3 : i + 4 : 3, j - 3 : j + 4 : 3].ravel()
    elsewhere = likeness.copy()
    elsewhere[max(0, i - 8) : i + 9, max(0, j - 8) : j + 9] = -1
    if elsewhere.max() > peak - LEAST_LEAD or np.delete(around, 4).max() > peak - LEAST_FALL:
        return None
    return (
        x,
        y,
        x + j - reach + _summit(likeness[i, j - 1 : j + 2]),
        y + i - reach + _summit(likeness[i - 1 : i + 2, j]),
    )


def _summit(values: NDArray[Any]) -> float:
    """Place of the parabola's top through values at -1, 0 and 1, of which the middle one is greatest."""
    left, middle, right = (float(value) for value in values)
    bend = left - 2 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0
