"""The inputs of shading that do not depend on the points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Shading:
    """The viewpoint, the source views and the constants of the colour model.

    Attributes:
        views: (N',) int32 indices of the source views to blend, empty if colours come only from spherical harmonics.
        view_weights: (N',) float32 factors in [0, 1] for the views' blend weights, C-contiguous. At least one is
            positive.
        centre: (3,) float64 position of the viewing camera in the world, C-contiguous.
        sh_range, sh_base: constants of the view-dependent colour ``sh_base + sh_range * tanh(sh . Y(d))``, where Y(d)
            are the spherical harmonics at the viewing direction d.
    """

    views: NDArray[np.int32]
    view_weights: NDArray[np.float32]
    centre: NDArray[np.float64]
    sh_range: float
    sh_base: float

    def arguments(self) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float64], float, float]:
        """Return the fields in the order in which the native kernels expect them."""
        return self.views, self.view_weights, self.centre, self.sh_range, self.sh_base
