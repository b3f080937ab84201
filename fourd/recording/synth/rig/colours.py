"""Exposure and white balance: each camera multiplies the colours by its own gains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def draw_gain(exposure: float, white_balance: float, rng: np.random.Generator) -> Array:
    """Draw the factors (3,) by which a camera multiplies red, green and blue.

    Args:
        exposure: standard deviation of the logarithm of the common factor.
        white_balance: standard deviation of the logarithm of each channel's own factor.
        rng: source of random numbers. The number of draws does not depend on the other arguments.
    """
    common, own = rng.normal(size=1), rng.normal(size=3)
    return np.asarray(np.exp(exposure * common + white_balance * own))


def apply_gain(picture: Array, gain: Array) -> Array:
    """Multiply the colours (H, W, 3) of a picture by the gains (3,). The gains act on stored values, which are not
    linear in the light: in linear light, the same change needs about the gain to the power of 2.2."""
    return picture * gain
