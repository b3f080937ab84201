"""The common focus of a ring of cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fourd.cameras import Camera

PARALLEL = 1e-4
"""Mean squared sine of the angle (0.6 degrees) to a common direction, below which the axes count as parallel."""


def find_focus(cameras: Sequence[Camera]) -> np.ndarray | None:
    """(3,) world point nearest to the cameras' optical axes in the least-squares sense; None for parallel axes."""
    projections = [np.eye(3) - np.outer(camera.forward, camera.forward) for camera in cameras]
    if np.linalg.eigvalsh(np.mean(projections, axis=0))[0] < PARALLEL:
        return None
    right = sum((p @ camera.centre for p, camera in zip(projections, cameras, strict=True)), np.zeros(3))
    return np.linalg.lstsq(np.sum(projections, axis=0), right, rcond=None)[0]
