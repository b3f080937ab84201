"""The common focus of a ring of cameras, which is the point that the cameras face."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fourd.cameras import Camera

PARALLEL = 1e-4
"""Optical axes count as parallel if the mean squared sine of their angles to their common direction is below this
value.

The value corresponds to an angle of 0.6 degrees.
"""


def find_focus(cameras: Sequence[Camera]) -> np.ndarray | None:
    """Find the world point (3,) nearest to all optical axes (least squares); return None if the axes are parallel."""
    projections = [np.eye(3) - np.outer(camera.forward, camera.forward) for camera in cameras]
    if np.linalg.eigvalsh(np.mean(projections, axis=0))[0] < PARALLEL:
        return None
    right = sum((p @ camera.centre for p, camera in zip(projections, cameras, strict=True)), np.zeros(3))
    return np.linalg.lstsq(np.sum(projections, axis=0), right, rcond=None)[0]
