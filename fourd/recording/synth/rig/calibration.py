"""Errors of a calibration: each camera is slightly turned and moved, with another lens than the true one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

Array = NDArray[np.float64]

ROTATION_DEG = 0.08
POSITION = 0.001
CENTRE_PX = 0.4
FOCAL = 0.001
"""Usual standard deviations of a camera's errors: of its rotation about each axis in degrees, of its position along
each axis as a fraction of the cameras' median distance from the point they look at, of its principal point along each
axis in pixels, and of its focal length as a fraction."""


@dataclass(frozen=True, eq=False)
class CalibrationError:
    """Difference of a camera's calibration from the truth.

    Attributes:
        rotation_deg: (3,) rotation vector in camera coordinates, in degrees.
        position: (3,) shift of the camera's centre in world units.
        centre_px: (2,) shift of the principal point in pixels.
        focal: relative change of the focal length.
    """

    rotation_deg: Array
    position: Array
    centre_px: Array
    focal: float

    def stored(self) -> dict[str, object]:
        """Return the errors as plain data for JSON files."""
        return {
            "rotation_deg": self.rotation_deg.tolist(),
            "position": self.position.tolist(),
            "centre_px": self.centre_px.tolist(),
            "focal": self.focal,
        }


def draw_error(strength: float, distance: float, rng: np.random.Generator) -> CalibrationError:
    """Draw the error of a camera, as a multiple of the usual errors. ``distance`` is the cameras' median distance from
    the point they look at, in world units."""
    return CalibrationError(
        rotation_deg=strength * ROTATION_DEG * rng.normal(size=3),
        position=strength * POSITION * distance * rng.normal(size=3),
        centre_px=strength * CENTRE_PX * rng.normal(size=2),
        focal=float(strength * FOCAL * rng.normal()),
    )


def disturb(camera: Camera, error: CalibrationError) -> Camera:
    """Return the camera that a calibration with this error contains."""
    turn = np.asarray(cv2.Rodrigues(np.radians(error.rotation_deg))[0], np.float64)
    rotation = turn @ camera.rotation
    intrinsics = camera.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= 1 + error.focal
    intrinsics[:2, 2] += error.centre_px
    centre = camera.centre + error.position
    return replace(camera, intrinsics=intrinsics, rotation=rotation, translation=-rotation @ centre)
