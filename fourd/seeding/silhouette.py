"""One soft matte as a signed distance image, with its camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera

Floats = NDArray[np.float32]

ROW = 4096
"""Samples in a row of the maps given to OpenCV's remap, which takes no side beyond 32,767."""


@dataclass(frozen=True, eq=False)
class SilhouetteView:
    """One matte with its camera, relative to an origin.

    Attributes:
        matrix: (3, 3) float32 K R.
        offset: (3,) float32, the projection of the origin.
        focal: geometric mean of the focal lengths, pixels.
        reach: largest pixel displacement of a unit displacement at unit depth inside the image.
        distance: (H, W) float32 signed distance to the silhouette in pixels, positive inside.
    """

    matrix: Floats
    offset: Floats
    focal: float
    reach: float
    distance: Floats

    @staticmethod
    def of(mask: NDArray[np.uint8], camera: Camera, origin: Array) -> SilhouetteView:
        """The view of ``mask`` (H, W) uint8 by ``camera``; points will be given relative to ``origin``.

        Raises:
            ValueError: when the mask's shape is not the camera's.
        """
        if mask.shape != (camera.height, camera.width):
            raise ValueError(f"mask: expected shape {(camera.height, camera.width)} as the camera, got {mask.shape}")
        k = camera.intrinsics
        matrix = k @ camera.rotation
        offset = k @ (camera.rotation @ origin + camera.translation)
        corners = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]])
        tangents = (corners - k[:2, 2]) / (k[0, 0], k[1, 1])
        steepest = float(np.sqrt(1 + (tangents**2).sum(axis=1).max()))
        return SilhouetteView(
            matrix.astype(np.float32),
            offset.astype(np.float32),
            float(np.sqrt(k[0, 0] * k[1, 1])),
            float(max(k[0, 0], k[1, 1])) * steepest,
            signed_distance(mask),
        )

    def project(self, xyz: Floats) -> tuple[Floats, Floats, Floats]:
        """Pixels x, y and depth of points (3, N) relative to the origin; pixels mean nothing where z <= 0."""
        x, y, z = self.matrix @ xyz + self.offset[:, None]
        inverse = 1 / np.where(np.abs(z) > 1e-12, z, np.float32(1e-12))
        x *= inverse
        y *= inverse
        return x, y, z

    def sees(self, x: Floats, y: Floats, z: Floats) -> NDArray[np.bool_]:
        """Which projected points fall into the image, in front of the camera."""
        height, width = self.distance.shape
        return (z > 0) & (x >= 0) & (x <= width) & (y >= 0) & (y <= height)


def signed_distance(mask: NDArray[np.uint8]) -> Floats:
    """Signed distance (H, W) float32 in pixels to where a soft matte (H, W) uint8 crosses one half.

    Pixels beside the crossing hold ``matte - 0.5``, so that bilinear samples cross zero where
    the matte's do. The image's border is no silhouette. A matte that is empty or full gets
    the image's diagonal everywhere.
    """
    inside = (mask >= 128).astype(np.uint8)
    far = float(np.hypot(*mask.shape))
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
    """Values of ``image`` (H, W[, C]) at pixels x, y (N,), where pixel centres lie at half integers.

    ``method`` is cv2.INTER_NEAREST or cv2.INTER_LINEAR. Outside the image the border repeats.
    Returns (N[, C]) of the image's dtype.
    """
    count = x.size
    rows = -(-count // ROW)
    maps = np.zeros((2, rows * ROW if rows > 1 else count), dtype=np.float32)
    limit = np.float32(1 << 14)
    np.clip(x - np.float32(0.5), -limit, limit, out=maps[0, :count])
    np.clip(y - np.float32(0.5), -limit, limit, out=maps[1, :count])
    map_x, map_y = maps[0].reshape(max(rows, 1), -1), maps[1].reshape(max(rows, 1), -1)
    values = cv2.remap(image, map_x, map_y, method, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(-1, *image.shape[2:])[:count]
