"""The rotation that turns the up direction of a capture to Blender's +z axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.viewer.blender.addon.points import View

AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0), "-Y": (0.0, -1.0, 0.0)}
NEARLY_AN_AXIS = np.cos(np.radians(15))


def up_of(choice: str, views: Sequence[View]) -> NDArray[np.float64]:
    """Return the up direction (3,) of a scene: an axis by its name, or for "AUTO" the mean up direction of the cameras.
    If this mean is within 15 degrees of an axis, the axis is meant: cameras look down more often than up."""
    if choice != "AUTO":
        return np.array(AXES[choice])
    if not views:
        return np.array(AXES["Z"])
    mean = -np.mean([view.rotation[1] for view in views], axis=0)
    length = float(np.linalg.norm(mean))
    if length < 0.1:  # the cameras are turned in all directions
        return np.array(AXES["Z"])
    axis = np.zeros(3)
    largest = int(np.abs(mean).argmax())
    axis[largest] = np.sign(mean[largest])
    return axis if mean @ axis >= NEARLY_AN_AXIS * length else mean / length


def rotation_to_z(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest rotation (3, 3) that turns a unit vector to +z."""
    target = np.array(AXES["Z"])
    cosine = float(up @ target)
    if cosine < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    x, y, z = np.cross(up, target)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)
