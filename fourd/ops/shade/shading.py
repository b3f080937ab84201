"""The viewpoint and the constants that shading needs beside the points' arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Shading:
    """A viewpoint, and the constants of the colour model.

    Attributes:
        views: (K,) int32 indices of the source views to blend; empty for spherical harmonics only.
        centre: (3,) float64 position of the viewing camera in the world, C-contiguous.
        sh_range, sh_base: the view-dependent part is ``sh_base + sh_range * tanh(sh . Y(d))``.
    """

    views: NDArray[np.int32]
    centre: NDArray[np.float64]
    sh_range: float
    sh_base: float

    def arguments(self) -> tuple[NDArray[np.int32], NDArray[np.float64], float, float]:
        """The fields in the order in which the native kernels take them."""
        return self.views, self.centre, self.sh_range, self.sh_base
