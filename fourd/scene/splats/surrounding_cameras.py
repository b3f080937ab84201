"""Cameras for files without cameras, such as files of splats and meshes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at

CAMERAS = 8
"""Number of cameras in the ring."""
IMAGE_SIZE, FOCAL = (960, 720), 800.0


def cameras_around(focus: NDArray[np.float64], diagonal: float, up: NDArray[np.float64]) -> tuple[Camera, ...]:
    """Return cameras in a ring around a subject.

    Args:
        focus: (3,) centre of the subject in world units.
        diagonal: length of the diagonal of the subject's bounding box, in world units, above 0.
        up: (3,) unit vector, the up direction of the ring.
    """
    width, height = IMAGE_SIZE
    intrinsics = np.array([[FOCAL, 0, width / 2], [0, FOCAL, height / 2], [0, 0, 1]])
    distance = 1.05 * diagonal * FOCAL / height
    axis = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[2]
    right = axis - (axis @ up) * up
    right /= np.linalg.norm(right)
    front = np.cross(right, up)
    found = []
    for angle in 2 * np.pi * np.arange(CAMERAS) / CAMERAS:
        side = np.sin(angle) * right + np.cos(angle) * front + 0.2 * up
        found.append(look_at(focus + distance * side, focus, up, intrinsics, width, height))
    return tuple(found)
