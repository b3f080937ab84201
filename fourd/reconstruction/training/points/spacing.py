"""Point spacing: the distance between neighbouring points. A point's radius is a multiple of its spacing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.neighbours import nearest_neighbours

NEIGHBOURS = 4
DEFAULT_SPACING = 0.01
"""Spacing in world units that is assumed for clouds with too few points to measure it."""
MAX_SAMPLES = 4096
MEAN_NEIGHBOUR_DISTANCE = 1.2
"""Mean distance of a point to its four nearest neighbours, divided by the spacing, for points that are spread evenly
over a surface."""


def point_spacings(xyz: NDArray[np.float32], rows: NDArray[np.intp] | None = None) -> NDArray[np.float32]:
    """Estimate the spacing (M,) at the points ``xyz[rows]``, or at all points ``xyz`` (N, 3) if ``rows`` is None.

    The estimate assumes that the points are spread evenly over a surface.
    """
    queried = xyz if rows is None else xyz[rows]
    if len(xyz) <= NEIGHBOURS:
        return np.full(len(queried), DEFAULT_SPACING, np.float32)
    distances, _ = nearest_neighbours(xyz, queried, NEIGHBOURS + 1)
    return np.maximum(np.asarray(distances)[:, 1:].mean(axis=1) / MEAN_NEIGHBOUR_DISTANCE, 1e-6).astype(np.float32)


def mean_spacing(xyz: NDArray[np.float32]) -> float:
    """Compute the mean spacing at the first 4,096 points of ``xyz`` (N, 3).

    The spacing is computed from the mean distance to four neighbours, because the distance to the nearest neighbour
    alone would depend more on how evenly the points are spread.
    """
    if len(xyz) <= NEIGHBOURS + 1:
        return DEFAULT_SPACING
    distances, _ = nearest_neighbours(xyz, xyz[:MAX_SAMPLES], NEIGHBOURS + 1)
    return float(np.asarray(distances)[:, 1:].mean() / MEAN_NEIGHBOUR_DISTANCE)
