"""Input of stereo: an image with its camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera


@dataclass(frozen=True, eq=False)
class StereoView:
    """One camera's image of a static scene, or of a scene at the moment of all other images.

    Attributes:
        name: name of the camera.
        camera: pinhole camera of the undistorted image.
        rgb: (H, W, 3) uint8 colours; undefined where ``seen`` is false.
        seen: (H, W) bool, false in holes and outside the lens's field of view.
    """

    name: str
    camera: Camera
    rgb: NDArray[np.uint8]
    seen: NDArray[np.bool_]
