"""Computes colours for the parts of a mesh that no view sees, and for the texels between charts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

Floats = NDArray[np.float32]

GREY = 0.5
"""Grey value, in [0, 1], of the vertices of a connected component of the mesh if no view sees any of them."""


def fill_vertices(rgb: Floats, known: NDArray[np.bool_], triangles: NDArray[np.integer]) -> Floats:
    """Compute the colours of all vertices from the known colours of some vertices.

    The other vertices get harmonic colours: each colour is the mean of the neighbours' colours (membrane inpainting on
    the surface). Neighbours are vertices that share a mesh edge, not vertices that are close in the texture, because
    adjacent charts may belong to different parts of the surface.

    Args:
        rgb: (N, 3) colours.
        known: (N,) bool, true for vertices with a known colour.
        triangles: (M, 3) vertex indices.

    Returns:
        (N, 3) colours. Known colours are unchanged. Connected components without a known colour become grey.
    """
    count = len(rgb)
    if known.all():
        return rgb
    rows = np.concatenate([triangles[:, a] for a in (0, 1, 2, 1, 2, 0)])
    columns = np.concatenate([triangles[:, a] for a in (1, 2, 0, 0, 1, 2)])
    adjacency = coo_array((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    adjacency.data[:] = 1
    # A small weight towards grey keeps the linear system nonsingular if a connected mesh part has no known colour.
    grey_weight = 1e-6
    degree = np.asarray(adjacency.sum(axis=1)).ravel() + grey_weight
    unknown = np.flatnonzero(~known)
    system = (diags_array(degree) - adjacency).tocsr()[unknown]
    target = grey_weight * GREY - system[:, np.flatnonzero(known)] @ rgb[known].astype(np.float64)
    filled = rgb.copy()
    solution = spsolve(system[:, unknown].tocsc(), target)
    filled[unknown] = np.asarray(solution).reshape(-1, 3).clip(0, 1)
    return filled


def fill_between_charts(texture: Floats, covered: NDArray[np.bool_]) -> Floats:
    """Give each texel outside the charts the colour of the nearest texel in a chart.

    Bilinear samples at chart borders and the texels of coarser mip levels thus contain only colours of charts.

    Args:
        texture: (S, S, 3) colours.
        covered: (S, S) bool, true for texels in a chart.
    """
    if covered.all() or not covered.any():
        return texture
    rows, columns = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return np.asarray(texture[rows, columns], np.float32)
