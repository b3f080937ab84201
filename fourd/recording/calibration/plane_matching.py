"""Matches on a plane in the world, for wide baselines where features differ too much between images.

The calibration is used to rectify both images to the plane. Each small patch of one rectified image is then matched to
the most similar patch of the other rectified image, near the position that the calibration predicts. The calibration
affects only how a patch looks and where its search is centred. The position of the match is measured in the images, so
it reveals errors of the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.calibration.matching import Matches, distort_points

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

HALF_PATCH = 24
MIN_CORRELATION = 0.75
MIN_LEAD = 0.12
"""Minimum difference between the peak, which is the highest correlation in the search region, and the highest
correlation at positions more than 8 pixels away from the peak."""
MIN_DROP = 0.03
"""Minimum decrease of the correlation from its peak to each of the eight positions at offsets of 3 pixels along x, y or
both axes.

This rejects patches on a straight edge, because their correlation stays high along the edge.
"""
MIN_CONTRAST = 6.0
MIN_HEIGHT = 1e-3
"""Minimum distance of a camera from the plane, as a fraction of the patch's width. A camera in the plane sees it as a
line."""


@dataclass(frozen=True, eq=False)
class PlanePatch:
    """A rectangle on a plane in the world, sampled as a raster.

    Attributes:
        corner: (3,) world position of the corner at the raster's origin.
        right: (3,) unit vector in the world along the raster's rows.
        down: (3,) unit vector in the world along the raster's columns, perpendicular to ``right``.
        width: width of the rectangle in world units.
        height: height of the rectangle in world units.
        resolution: raster pixels per world unit.
    """

    corner: Array
    right: Array
    down: Array
    width: float
    height: float
    resolution: float

    def height_of(self, camera: Camera) -> float:
        """Return the signed distance of the camera's centre from the plane, in world units."""
        return float((camera.centre - self.corner) @ np.cross(self.right, self.down))

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the raster in pixels."""
        return round(self.width * self.resolution), round(self.height * self.resolution)

    def to_picture(self, camera: Camera) -> Array:
        """Return the homography (3, 3) from raster pixels to pixels of the undistorted image. In both, pixel corners
        have integer coordinates."""
        K, R_camera_world = camera.intrinsics, camera.rotation
        step = 1 / self.resolution
        origin = R_camera_world @ self.corner + camera.translation
        axes = [step * R_camera_world @ self.right, step * R_camera_world @ self.down, origin]
        return np.asarray(K @ np.column_stack(axes), np.float64)


def match_on_plane(
    first: Picture, second: Picture, cameras: tuple[Camera, Camera], patch: PlanePatch, search_radius: int = 28
) -> Matches:
    """Match points on and near the plane of ``patch`` between two simultaneous RGB images (H, W, 3).

    Args:
        first: distorted image of the first camera.
        second: distorted image of the second camera.
        cameras: the two cameras, with distortion.
        patch: rectangle on the plane; both images are rectified to it.
        search_radius: largest displacement between the two rectified images that is searched, in raster pixels.

    Returns:
        The matches, in pixels of the distorted images. Corner features are detected in the first rectified image. The
        window around each feature is compared with the second rectified image by normalized cross-correlation. The
        feature is matched if the correlation has one distinct peak.
    """
    if any(abs(patch.height_of(camera)) < MIN_HEIGHT * patch.width for camera in cameras):
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    (raster, valid), (other, other_valid) = (
        _rectify(picture, camera, patch) for picture, camera in zip((first, second), cameras, strict=True)
    )
    margin = 2 * (HALF_PATCH + search_radius) + 1
    inside = cv2.erode(
        valid & other_valid, np.ones((margin, margin), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    equalized = cv2.createCLAHE(3.0, (8, 8)).apply(raster)
    corners = cv2.goodFeaturesToTrack(equalized, 400, 0.005, 8, mask=inside, blockSize=15)
    found = [] if corners is None else [_search(raster, other, int(x), int(y), search_radius) for x, y in corners[:, 0]]
    pairs = np.array([pair for pair in found if pair is not None]).reshape(-1, 4) + 0.5
    return Matches(
        *(_to_picture_px(camera, patch, xy) for camera, xy in zip(cameras, (pairs[:, :2], pairs[:, 2:]), strict=True))
    )


def _rectify(picture: Picture, camera: Camera, patch: PlanePatch) -> tuple[Picture, Picture]:
    """Rectify an image to the patch's raster.

    Returns:
        The slightly smoothed grey raster, and a mask that is 255 at raster pixels inside the image and 0 elsewhere.
    """
    columns, rows = patch.size
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    to_ray = np.linalg.inv(camera.intrinsics) @ patch.to_picture(camera) @ half
    k = camera.intrinsics.copy()
    k[:2, 2] -= 0.5
    # OpenCV maps each raster pixel to a viewing ray by the inverse of the matrix argument, and then applies the lens
    # distortion. The matrix may be any homography, so one call maps raster pixels to pixels of the distorted image.
    map_x, map_y = cv2.initUndistortRectifyMap(
        k, camera.distortion, None, np.linalg.inv(to_ray), patch.size, cv2.CV_32FC1
    )
    xy = np.stack([map_x, map_y], axis=2)
    depth = to_ray[2, 0] * np.arange(columns) + (to_ray[2, 1] * np.arange(rows) + to_ray[2, 2])[:, None]
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    raster = cv2.remap(grey, xy[..., 0], xy[..., 1], cv2.INTER_LINEAR)
    height, width = grey.shape
    valid = (depth > 0) & (xy >= 0).all(axis=2) & (xy[..., 0] <= width - 1) & (xy[..., 1] <= height - 1)
    return np.asarray(cv2.GaussianBlur(raster, (0, 0), 1.0), np.uint8), np.where(valid, 255, 0).astype(np.uint8)


def _to_picture_px(camera: Camera, patch: PlanePatch, raster_px: Array) -> Array:
    xyw = np.column_stack([raster_px, np.ones(len(raster_px))]) @ patch.to_picture(camera).T
    return distort_points(camera, xyw[:, :2] / xyw[:, 2:])


def _search(
    raster: Picture, other: Picture, x: int, y: int, search_radius: int
) -> tuple[float, float, float, float] | None:
    """Search the rectified image ``other`` for the window around the pixel (x, y) of the rectified image ``raster``.

    Returns:
        (x, y) and the subpixel position of the match in ``other``, or None if the correlation has no distinct peak.
    """
    reach = HALF_PATCH + search_radius
    template = raster[y - HALF_PATCH : y + HALF_PATCH + 1, x - HALF_PATCH : x + HALF_PATCH + 1]
    if template.std() < MIN_CONTRAST:
        return None
    correlation = cv2.matchTemplate(
        other[y - reach : y + reach + 1, x - reach : x + reach + 1], template, cv2.TM_CCOEFF_NORMED
    )
    _, peak, _, (j, i) = cv2.minMaxLoc(correlation)
    if peak < MIN_CORRELATION or not (3 <= i < 2 * search_radius - 2 and 3 <= j < 2 * search_radius - 2):
        return None
    around = correlation[i - 3 : i + 4 : 3, j - 3 : j + 4 : 3].ravel()
    elsewhere = correlation.copy()
    elsewhere[max(0, i - 8) : i + 9, max(0, j - 8) : j + 9] = -1
    if elsewhere.max() > peak - MIN_LEAD or np.delete(around, 4).max() > peak - MIN_DROP:
        return None
    return (
        x,
        y,
        x + j - search_radius + _parabola_peak(correlation[i, j - 1 : j + 2]),
        y + i - search_radius + _parabola_peak(correlation[i - 1 : i + 2, j]),
    )


def _parabola_peak(values: NDArray[Any]) -> float:
    """Return the position of the maximum of the parabola through three ``values`` at -1, 0 and 1."""
    left, middle, right = (float(value) for value in values)
    curvature = left - 2 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0 else 0.0
