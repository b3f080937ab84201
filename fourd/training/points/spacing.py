"""Point spacing: the distance between neighbouring points. The radius of a point is a multiple of the point's
spacing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.ops.neighbours import nearest_neighbours

NEIGHBOURS = 4
DEFAULT_SPACING = 0.01
"""Assumed spacing, in world units, of clouds with too few points to measure the spacing."""
MAX_SAMPLES = 4096
MEAN_NEIGHBOUR_DISTANCE = 1.2
"""Mean distance of a point to its four nearest neighbours, divided by the spacing, if the points are spread evenly over
a surface."""


def point_spacings(xyz: NDArray[np.float32], rows: NDArray[np.intp] | None = None) -> NDArray[np.float32]:
    """(M,) spacing at the points ``xyz[rows]``, or at all points ``xyz`` (N, 3) if ``rows`` is None.

    The spacing is estimated as if the points were spread evenly over a surface.
    """
    queried = xyz if rows is None else xyz[rows]
    if len(xyz) <= NEIGHBOURS:
        return np.full(len(queried), DEFAULT_SPACING, np.float32)
    distances, _ = nearest_neighbours(xyz, queried, NEIGHBOURS + 1)
    return np.maximum(np.asarray(distances)[:, 1:].mean(axis=1) / MEAN_NEIGHBOUR_DISTANCE, 1e-6).astype(np.float32)


def mean_spacing(xyz: NDArray[np.float32]) -> float:
    """Mean spacing at the first 4,096 points of ``xyz`` (N, 3).

    The spacing is computed from the mean distance to four neighbours. The distance to the nearest neighbour alone would
    depend more on how evenly the points are spread.
    """
    if len(xyz) <= NEIGHBOURS + 1:
        return DEFAULT_SPACING
    distances, _ = nearest_neighbours(xyz, xyz[:MAX_SAMPLES], NEIGHBOURS + 1)
    return float(np.asarray(distances)[:, 1:].mean() / MEAN_NEIGHBOUR_DISTANCE)
