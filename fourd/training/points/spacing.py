"""Distances between neighbouring points, the unit of their radii."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS = 4
MEAN_NEIGHBOUR_DISTANCE = 1.2
"""Mean distance to the four nearest neighbours of points spread evenly over a surface, in units of their spacing."""


def point_spacings(xyz: NDArray[np.float32], rows: NDArray[np.intp] | None = None) -> NDArray[np.float32]:
    """(M,) spacing at the points ``rows`` (M,) of (N, 3), or at all of them, as if spread evenly over a surface."""
    queried = xyz if rows is None else xyz[rows]
    if len(xyz) <= NEIGHBOURS:
        return np.full(len(queried), 0.01, np.float32)
    distances, _ = cKDTree(xyz).query(queried, k=NEIGHBOURS + 1, workers=-1)
    return np.maximum(distances[:, 1:].mean(axis=1) / MEAN_NEIGHBOUR_DISTANCE, 1e-6).astype(np.float32)
