"""When each row of an image is exposed: time offsets between cameras, rolling shutter and motion blur.

All three are weights with which a row averages the scene over time. The scene is known at knots, which are evenly
spaced times, and changes linearly between them. The middle row of a camera without offset is exposed around the time of
its frame, so that neither the rolling shutter nor the motion blur delays the image as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shutter:
    """Times in units of the time between two frames.

    Attributes:
        offset: time by which the camera records each frame later than the others.
        readout: time from the exposure of the first row to that of the last row.
        exposure: time for which each row is exposed.
    """

    offset: float = 0.0
    readout: float = 0.0
    exposure: float = 0.0


def draw_offset(largest: float, rng: np.random.Generator) -> float:
    """Draw a camera's time offset between -``largest`` and ``largest`` in frames."""
    return float(largest * rng.uniform(-1, 1))


def row_weights(shutter: Shutter, frame: int, height: int, knots_per_frame: int) -> dict[int, Array]:
    """Return the weights (H,) of the rows for each knot that contributes to a frame; the weights of each row add up to
    1. Knot k is at the time k / ``knots_per_frame`` in frames."""
    rows = (np.arange(height) + 0.5) / height - 0.5
    middle = (frame + shutter.offset + shutter.readout * rows) * knots_per_frame
    half = shutter.exposure * knots_per_frame / 2
    first, last = int(np.floor(middle.min() - half)), int(np.ceil(middle.max() + half))
    weights = {knot: _weight(middle - knot, half) for knot in range(first, last + 1)}
    return {knot: weight for knot, weight in weights.items() if weight.max() > 1e-9}


def _weight(middle: Array, half: float) -> Array:
    """Return the mean of a hat function, which is 1 at 0 and 0 at -1 and 1, over ``middle`` +- ``half``."""
    if half < 1e-6:
        return np.maximum(1 - np.abs(middle), 0)
    return np.asarray((_hat_integral(middle + half) - _hat_integral(middle - half)) / (2 * half))


def _hat_integral(x: Array) -> Array:
    """Return the integral of the hat function from -1 to ``x``."""
    x = np.clip(x, -1, 1)
    return np.where(x < 0, (x + 1) ** 2 / 2, 1 - (1 - x) ** 2 / 2)
