"""Lens blur: the image of a point is a disc with soft edges."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPREAD = 0.25
"""Largest relative difference of a camera's blur from the mean."""


def draw_blur(mean_px: float, rng: np.random.Generator) -> float:
    """Draw the standard deviation of a camera's lens blur in pixels."""
    return float(mean_px * (1 + rng.uniform(-SPREAD, SPREAD)))


def blur_lens(picture: Array, sigma_px: float) -> Array:
    """Blur a picture (H, W, 3) or a matte (H, W) with a Gaussian. The result is a new array."""
    if sigma_px == 0:
        return picture.copy()
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float64)
