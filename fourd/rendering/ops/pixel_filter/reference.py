"""The pixel filter for float images, which is also the reference for the 8-bit kernels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def filter_pixels_reference(image: NDArray[np.float32], side: float) -> NDArray[np.float32]:
    """Filter an image (H, W) or (H, W, C) with the weights ``(side, 1 - 2 * side, side)`` along rows and columns.

    Pixels outside the image are copies of the nearest pixel inside. The result has the shape of ``image``.
    """
    if side == 0 or image.size == 0:
        return image
    weights = np.array([side, 1 - 2 * side, side], np.float32)
    filtered = cv2.sepFilter2D(image, cv2.CV_32F, weights, weights, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(filtered, np.float32).reshape(image.shape)
