"""A view of the object: a camera and a signed distance image, which is computed from a soft matte."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera

Floats = NDArray[np.float32]

ROW = 4096
"""Number of samples per row of the coordinate maps that are passed to OpenCV's remap. OpenCV requires that the maps'
width and height are below 32,767."""


MAX_SIDE_PX = 1024
"""Maximum length in pixels of the longer side of a matte's crop around the object. Larger crops are scaled down to this
length to limit the memory for large captures."""


@dataclass(frozen=True, eq=False)
class SilhouetteView:
    """The signed distance image of one matte, together with the matte's camera. Coordinates of points are relative to
    an origin.

    Pixel coordinates refer to the distance image, not to the matte. The distance image covers a crop of the matte
    around the object. If the crop is large, the distance image has a lower resolution than the matte.

    Attributes:
        matrix: (3, 3) float32 matrix product K * R of intrinsics and rotation.
        offset: (3,) float32 homogeneous pixel coordinates of the origin.
        focal: geometric mean of the focal lengths in pixels.
        reach: upper bound of the speed at which a point's projection moves in the image, in pixels per world unit that
            the point moves in space. It applies to points inside the image at a depth of one world unit. At depth z,
            the bound is ``reach / z``.
        frame: left, top, right and bottom borders of the whole image, in pixel coordinates of the distance image.
        distance: (h, w) float32 signed distance to the silhouette in pixels, positive inside. A point outside the crop
            gets the value at the crop's nearest pixel. The point is at least as far outside the silhouette as this
            value says.
    """

    matrix: Floats
    offset: Floats
    focal: float
    reach: float
    frame: tuple[float, float, float, float]
    distance: Floats

    @staticmethod
    def from_mask(mask: NDArray[np.uint8], camera: Camera, origin: Array) -> SilhouetteView:
        """Create the view from ``mask`` (H, W) uint8 and its ``camera``. Coordinates of points are relative to
        ``origin``.

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
        """Return the pixel coordinates x and y and depths z of points (3, N). For points with z <= 0, x and y are
        undefined."""
        x, y, z = self.matrix @ xyz + self.offset[:, None]
        inverse = 1 / np.where(np.abs(z) > 1e-12, z, np.float32(1e-12))
        x *= inverse
        y *= inverse
        return x, y, z

    def sees(self, x: Floats, y: Floats, z: Floats) -> NDArray[np.bool_]:
        """Return a bool array (N,) that is True for projected points that are inside the image and in front of the
        camera."""
        left, top, right, bottom = self.frame
        return (z > 0) & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)

    def border_distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance (N,) in pixels from each projected point to the nearest image border, negative outside
        the image."""
        left, top, right, bottom = (np.float32(side) for side in self.frame)
        return np.minimum(np.minimum(x - left, right - x), np.minimum(y - top, bottom - y))


def _object_box(mask: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Return the left, top, width and height of the bounding box of the object in ``mask``. The box has a margin and is
    clipped to the image.

    The margin is a sixteenth of the image's longer side plus 8 pixels, so that the distances beside the object are
    exact enough to classify coarse cells.
    """
    left, top, width, height = cv2.boundingRect((mask >= 128).view(np.uint8))
    if width == 0:
        return 0, 0, 1, 1
    margin = 8 + max(mask.shape) // 16
    right, bottom = min(mask.shape[1], left + width + margin), min(mask.shape[0], top + height + margin)
    left, top = max(0, left - margin), max(0, top - margin)
    return left, top, right - left, bottom - top


def signed_distance(mask: NDArray[np.uint8]) -> Floats:
    """Return the signed distance (H, W) float32 in pixels to the contour of a soft matte (H, W) uint8. On the contour,
    the matte is 127.5.

    Let m be the matte scaled to [0, 1]. In pixels next to the contour, the distance is set to m - 0.5. Bilinear samples
    of the distance are therefore 0 where bilinear samples of m are 0.5. The image border is not part of the contour.
    The distance is -65,536 everywhere for an empty matte, and 65,536 for a full matte.
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
    """Sample ``image`` (H, W[, C]) at pixel coordinates x (N,) and y (N,). Pixel centres are at half integers.

    ``method`` is cv2.INTER_NEAREST or cv2.INTER_LINEAR. Positions outside the image get the value of the nearest border
    pixel. The result has the shape (N[, C]) and the image's dtype.
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
