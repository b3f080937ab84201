"""Removal of small connected parts from a mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Floats = NDArray[np.float32]


def drop_crumbs(
    xyz: Floats, triangles: NDArray[np.integer], min_share: float = 0.01
) -> tuple[Floats, NDArray[np.int64]]:
    """Remove small connected parts and closed cavities from a mesh.

    Args:
        xyz: (N, 3) vertices.
        triangles: (M, 3) vertex indices, counter-clockwise seen from outside.
        min_share: parts are kept if their area is at least this fraction, in [0, 1], of the largest part's area.

    Returns:
        the remaining vertices and triangles, in their original order, without unused vertices. The surface of a cavity
        has a negative signed volume, because its normals point into the cavity. Of the parts that are large enough,
        only those with a positive signed volume are kept. If there is none, all large enough parts are kept.

    Raises:
        ValueError: if ``min_share`` is outside [0, 1].
    """
    if not 0 <= min_share <= 1:
        raise ValueError(f"min_share: expected a share in [0, 1], got {min_share}")
    faces = np.asarray(triangles, np.int64)
    if len(faces) == 0:
        return xyz[:0], faces
    rows, columns = faces[:, [0, 1]].T, faces[:, [1, 2]].T
    edges = np.concatenate([rows, columns], axis=1)
    graph = coo_array((np.ones(edges.shape[1], np.bool_), (edges[0], edges[1])), shape=(len(xyz), len(xyz)))
    count, label = connected_components(graph, directed=False)
    part = label[faces[:, 0]]
    a, b, c = (xyz[faces[:, corner]].astype(np.float64) for corner in range(3))
    area = np.bincount(part, np.linalg.norm(np.cross(b - a, c - a), axis=1), count)
    volume = np.bincount(part, np.einsum("ij,ij->i", a, np.cross(b, c)), count)
    keep = (area > 0) & (area >= min_share * area.max())
    if (volume[keep] > 0).any():
        keep &= volume > 0
    kept = faces[keep[part]]
    used, index = np.unique(kept, return_inverse=True)
    return xyz[used], index.reshape(-1, 3)
