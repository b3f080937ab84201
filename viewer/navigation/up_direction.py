"""Which way is up: nothing in a capture says so, but people hold cameras upright."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera

Array = NDArray[np.float64]


def estimate_up(cameras: Sequence[Camera]) -> Array:
    """(3,) unit mean of the cameras' upward (-y) axes; the first camera's where they cancel out."""
    mean = np.mean([-camera.rotation[1] for camera in cameras], axis=0)
    if np.linalg.norm(mean) < 1e-3:
        mean = -cameras[0].rotation[1]
    return mean / np.linalg.norm(mean)
