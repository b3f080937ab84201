"""Sensor noise: read noise, which is the same in all pixels, and shot noise, which grows with the light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

READ_VARIANCE = 0.3
"""Variance of the read noise, as a fraction of the whole variance at the grey level REFERENCE."""
REFERENCE = 126.0


def noise_variance(strength: float, grey: Array) -> Array:
    """Return the variance of the noise at grey levels from 0 to 255. It is ``strength`` squared at the grey level 126,
    of which 30% is read noise."""
    return np.asarray(strength**2 * (READ_VARIANCE + (1 - READ_VARIANCE) * np.maximum(grey, 0) / REFERENCE))


def add_noise(picture: Array, strength: float, rng: np.random.Generator) -> Array:
    """Add noise to the grey levels (H, W, 3) of a picture. Channels and pixels are independent."""
    if strength == 0:
        return picture
    return picture + rng.normal(size=picture.shape) * np.sqrt(noise_variance(strength, picture))
