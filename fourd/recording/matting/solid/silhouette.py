"""Where the points of a subject appear in an image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera


def point_silhouette(xyz: Array, spacing: float, camera: Camera) -> NDArray[np.bool_]:
    """Return the mask (h, w) of the pixels that points (N, 3) cover.

    Args:
        xyz: points on the subject, in world units.
        spacing: largest distance between neighbouring points on a surface; smaller gaps are filled.
        camera: the camera of the image.
    """
    mask = np.zeros((camera.height, camera.width), np.uint8)
    pixels, depth = camera.project(xyz)
    inside = camera.is_in_image(pixels, depth)
    if not inside.any():
        return mask > 0
    column, row = pixels[inside].astype(np.intp).T
    mask[row, column] = 1
    gap_px = 2 * int(np.ceil(camera.intrinsics[1, 1] * spacing / np.median(depth[inside]) / 2)) + 1
    square = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap_px, gap_px))
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, square) > 0)
