"""Estimates the up direction of a capture, because a calibration does not define an up direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera

Array = NDArray[np.float64]


def estimate_up(cameras: Sequence[Camera]) -> Array:
    """Normalised mean (3,) of the cameras' -y axes, which point up in the images.

    If the axes cancel out, the result is the -y axis of the first camera.
    """
    mean = np.mean([-camera.rotation[1] for camera in cameras], axis=0)
    if np.linalg.norm(mean) < 1e-3:
        mean = -cameras[0].rotation[1]
    return mean / np.linalg.norm(mean)
