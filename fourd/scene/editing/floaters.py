"""Finds floaters: small groups of points that hang in the air, apart from the subject."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fourd.recording.capture.layout import sample_indices

SHARE = 0.02
"""Groups with fewer points than this share of the largest group are floaters, if the user names no other share."""
_SAMPLES = 2000
_NEIGHBOURS = 6
"""The spacing of the points is the median distance to this neighbour, so that pairs of nearly equal points do not
matter."""
_LINK = 2.5
"""Cells of this many spacings are connected with their 26 neighbours, so that two groups are apart if the gap between
them is wider than one to two cells."""
_TOUCH = 1.8
"""Distance, in cells, of the centres of cells that touch at a face, an edge or a corner: at most sqrt(3)."""


def find_parts(xyz: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the group (N,) of each position (N, 3). Points are in one group if a chain of points without a gap much
    wider than the usual distance between neighbouring points connects them."""
    if len(xyz) <= _NEIGHBOURS:
        return np.zeros(len(xyz), np.intp)
    tree = cKDTree(xyz)
    chosen = xyz[sample_indices(len(xyz), _SAMPLES)]
    distances = np.asarray(tree.query(chosen, k=[_NEIGHBOURS + 1])[0])  # the nearest is the point itself
    spacing = float(np.median(distances))
    cell = max(_LINK * spacing, 1e-9)
    cells, inverse = np.unique(np.floor((xyz - xyz.min(axis=0)) / cell).astype(np.int64), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(_TOUCH, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    labels = connected_components(links, directed=False)[1]
    return np.asarray(labels[inverse.reshape(-1)], np.intp)


def keep_large_parts(xyz: NDArray[np.float32], share: float = SHARE) -> NDArray[np.bool_]:
    """Return which of the positions (N, 3) are in a group with at least ``share`` of the points of the largest one."""
    if not len(xyz):
        return np.ones(0, bool)
    parts = find_parts(xyz)
    sizes = np.bincount(parts)
    return np.asarray(sizes[parts] >= share * sizes.max())
