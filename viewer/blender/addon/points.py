"""What the readers of the add-on return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


class ImportProblem(Exception):
    """A file that cannot be imported. The message is one line that names the file, what was expected and what was
    found."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """The points of one frame.

    Attributes:
        xyz: (N, 3) float32, world units.
        radius: (N,) float32, world units.
        density: (N,) float32 in [0, 1]: opacity at the centre.
        rgb: (N, 3) float32 in [0, 1], sRGB.
    """

    xyz: NDArray[np.float32]
    radius: NDArray[np.float32]
    density: NDArray[np.float32]
    rgb: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class View:
    """A camera with the axes of OpenCV (x right, y down, z forward): x_camera = rotation @ x_world + translation.

    Attributes:
        name: its name.
        width, height: size of its images in pixels.
        intrinsics: (3, 3), in pixels, for pixel centres at half-integers.
        rotation: (3, 3).
        translation: (3,), in world units.
    """

    name: str
    width: int
    height: int
    intrinsics: NDArray[np.float64]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) position of the camera in world units."""
        return -self.rotation.T @ self.translation
