"""How far apart points lie, on which their radii depend."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS = 4


def spacings(xyz: NDArray[np.float32], rows: NDArray[np.intp] | None = None) -> NDArray[np.float32]:
    """(M,) of an even sheet, from the distances of ``rows`` (M,) of points (N, 3) to their nearest neighbours."""
    asked = xyz if rows is None else xyz[rows]
    if len(xyz) <= NEIGHBOURS:
        return np.full(len(asked), 0.01, np.float32)
    distances, _ = cKDTree(xyz).query(asked, k=NEIGHBOURS + 1, workers=-1)
    return np.maximum(distances[:, 1:].mean(axis=1) / 1.2, 1e-6).astype(np.float32)
