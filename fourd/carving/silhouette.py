"""A view of the object: a camera and a signed distance image that is computed from a soft matte."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera

Floats = NDArray[np.float32]

ROW = 4096
"""Number of samples per row of the coordinate maps that are passed to OpenCV's remap. The sides of these maps must be
below 32,767."""


MAX_SIDE_PX = 1024
"""Maximum longer side in pixels of a matte's crop around the object; a larger crop is reduced to this size. The limit
bounds the memory use for large captures."""


@dataclass(frozen=True, eq=False)
class SilhouetteView:
    """One matte with its camera, for points relative to an origin.

    Pixel coordinates refer to the distance image. This image covers a crop of the matte around the object, and its
    resolution is lower than the matte's if the crop is large.

    Attributes:
        matrix: (3, 3) float32 matrix product K R of intrinsics and rotation.
        offset: (3,) float32 homogeneous projection of the origin.
        focal: geometric mean of the focal lengths in pixels.
        reach: upper bound of the displacement in pixels of a point at depth 1 per unit of its motion, for all points
            inside the image.
        frame: left, top, right and bottom borders of the whole image in pixels.
        distance: (h, w) float32 signed distance to the silhouette in pixels, positive inside. Outside the crop, the
            nearest pixel of the crop gives a lower bound of the distance to the object.
    """

    matrix: Floats
    offset: Floats
    focal: float
    reach: float
    frame: tuple[float, float, float, float]
    distance: Floats

    @staticmethod
    def from_mask(mask: NDArray[np.uint8], camera: Camera, origin: Array) -> SilhouetteView:
        """Build the view from ``mask`` (H, W) uint8 and its ``camera``, for points relative to ``origin``.

        Raises:
            ValueError: if the mask's shape does not match the camera's image size.
        """
        if mask.shape != (camera.height, camera.width):
            raise ValueError(
                f"mask: expected the camera's shape {(camera.height, camera.width)}, got shape {mask.shape}"
            )
        left, top, width, height = _object_box(mask)
        part: NDArray[np.uint8] = mask[top : top + height, left : left + width]
        close = camera.crop(left, top, width, height).rescale(min(1.0, MAX_SIDE_PX / max(width, height)))
        if (close.width, close.height) != (width, height):
            part = np.asarray(cv2.resize(part, (close.width, close.height), interpolation=cv2.INTER_AREA), np.uint8)
        zoom_x, zoom_y = close.width / width, close.height / height
        k = close.intrinsics
        frame = (-left * zoom_x, -top * zoom_y, (camera.width - left) * zoom_x, (camera.height - top) * zoom_y)
        tangents = (np.array([frame[:2], frame[2:]]) - k[:2, 2]) / (k[0, 0], k[1, 1])
        steepest = float(np.sqrt(1 + (tangents**2).max(axis=0).sum()))
        return SilhouetteView(
            (k @ camera.rotation).astype(np.float32),
            (k @ (camera.rotation @ origin + camera.translation)).astype(np.float32),
            float(np.sqrt(k[0, 0] * k[1, 1])),
            float(max(k[0, 0], k[1, 1])) * steepest,
            frame,
            signed_distance(part),
        )

    def project(self, xyz: Floats) -> tuple[Floats, Floats, Floats]:
        """Pixel coordinates x and y and depths z of points (3, N); x and y are undefined where z <= 0."""
        x, y, z = self.matrix @ xyz + self.offset[:, None]
        inverse = 1 / np.where(np.abs(z) > 1e-12, z, np.float32(1e-12))
        x *= inverse
        y *= inverse
        return x, y, z

    def sees(self, x: Floats, y: Floats, z: Floats) -> NDArray[np.bool_]:
        """(N,) bool: whether a projected point lies inside the image and in front of the camera."""
        left, top, right, bottom = self.frame
        return (z > 0) & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)

    def border_distance(self, x: Floats, y: Floats) -> Floats:
        """Distance (N,) in pixels to the nearest border of the whole image; negative outside the image."""
        left, top, right, bottom = (np.float32(side) for side in self.frame)
        return np.minimum(np.minimum(x - left, right - x), np.minimum(y - top, bottom - y))


def _object_box(mask: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Left, top, width and height of the object's bounding box in ``mask``, with a margin, clipped to the image.

    The margin is a sixteenth of the image's longer side plus 8 pixels. With this margin, distances beside the object
    are exact enough to classify coarse cells.
    """
    left, top, width, height = cv2.boundingRect((mask >= 128).view(np.uint8))
    if width == 0:
        return 0, 0, 1, 1
    margin = 8 + max(mask.shape) // 16
    right, bottom = min(mask.shape[1], left + width + margin), min(mask.shape[0], top + height + margin)
    left, top = max(0, left - margin), max(0, top - margin)
    return left, top, right - left, bottom - top


def signed_distance(mask: NDArray[np.uint8]) -> Floats:
    """Signed distance (H, W) float32 in pixels to the contour at which a soft matte (H, W) uint8 is one half.

    Pixels next to the contour store ``matte - 0.5``. Bilinear samples of the distance are therefore 0 where bilinear
    samples of the matte are one half. The image border is not part of the contour. The distance is -65,536 everywhere
    for an empty matte, and 65,536 for a full matte.
    """
    inside = (mask >= 128).astype(np.uint8)
    far = float(1 << 16)
    if not inside.any():
        return np.full(mask.shape, -far, dtype=np.float32)
    if inside.all():
        return np.full(mask.shape, far, dtype=np.float32)
    within = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_5)
    without = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_5)
    distance = within - without
    edge = np.abs(distance) <= 1.001
    distance -= np.float32(0.5) * np.sign(distance)
    soft = (mask.astype(np.float32) - 127.5) / 255
    np.copyto(distance, soft, where=edge)
    return distance


def sample(image: NDArray[np.float32] | NDArray[np.uint8], x: Floats, y: Floats, method: int) -> NDArray:
    """Sample ``image`` (H, W[, C]) at pixel coordinates x and y (N,), with pixel centres at half integers.

    ``method`` is cv2.INTER_NEAREST or cv2.INTER_LINEAR. Outside the image, the nearest border pixel is used. The
    result is (N[, C]) and has the image's dtype.
    """
    count = x.size
    if count == 0:
        return np.zeros((0, *image.shape[2:]), image.dtype)
    rows = -(-count // ROW)
    maps = np.zeros((2, rows * ROW if rows > 1 else count), dtype=np.float32)
    limit = np.float32(1 << 14)
    np.clip(x - np.float32(0.5), -limit, limit, out=maps[0, :count])
    np.clip(y - np.float32(0.5), -limit, limit, out=maps[1, :count])
    map_x, map_y = maps[0].reshape(rows, -1), maps[1].reshape(rows, -1)
    values = cv2.remap(image, map_x, map_y, method, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(-1, *image.shape[2:])[:count]
