"""Distances to the convex hull of a rig's cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]


def distance_to_hull(directions: Array, positions: Array, centre: Array) -> Array:
    """Return the distances (N,) from ``centre`` along the unit vectors ``directions`` (N, 3) to the convex hull of the
    ``positions`` (M, 3). They are 0 if the hull does not contain the centre, or if the positions are in a plane."""
    try:
        equations = ConvexHull(positions).equations
    except (QhullError, ValueError):
        return np.zeros(len(directions))
    normals, height = equations[:, :3], -(equations[:, :3] @ centre + equations[:, 3])
    if height.min() <= 0:
        return np.zeros(len(directions))
    slope = directions @ normals.T
    return np.asarray(np.where(slope > 0, height / np.where(slope > 0, slope, 1), np.inf).min(axis=1))
