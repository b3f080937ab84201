"""Vignetting: a lens collects less light towards the corners of the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPREAD = 0.3
"""Largest relative difference of a camera's vignetting from the mean."""


def draw_falloff(mean: float, rng: np.random.Generator) -> float:
    """Draw the share of the light that is missing in the corners of a camera's images."""
    return float(mean * (1 + rng.uniform(-SPREAD, SPREAD)))


def vignette(width: int, height: int, falloff: float) -> Array:
    """Return the factors (H, W, 1) by which the light of each pixel is multiplied. They decrease with the square of the
    distance from the middle of the image, from 1 to 1 - ``falloff`` at its corners."""
    x = (2 * (np.arange(width) + 0.5) / width - 1) * width
    y = (2 * (np.arange(height) + 0.5) / height - 1) * height
    square = (y[:, None] ** 2 + x[None, :] ** 2) / (width**2 + height**2)
    return np.asarray((1 - falloff * square)[..., None])
