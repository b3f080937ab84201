"""Smooths the normals of meshes for stylized images, in which small dents of a surface would show as speckle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.formats.mesh import Mesh

ROUNDS = 8
"""Number of smoothing rounds, each of which replaces a normal by the mean of the normals around it. Eight rounds
average over about the same surface area as the three rounds of :mod:`fourd.scene.styles.normals`."""


def smooth_normals(mesh: Mesh, rounds: int = ROUNDS) -> Mesh:
    """Return the mesh with smoothed normals. Positions do not change.

    Vertices of equal position and normal, such as those at the border of two texture charts, count as one vertex.
    Vertices of equal position and different normals form a sharp edge, which stays sharp.
    """
    assert mesh.normals is not None
    rows = np.concatenate([mesh.xyz, np.round(mesh.normals, 3)], 1)
    _, first, vertex = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    vertex = vertex.ravel()
    normals = mesh.normals[first].astype(np.float64)
    begin, end = _edges(vertex[mesh.triangles]).T
    for _ in range(rounds):
        agrees = (normals[begin] * normals[end]).sum(1) > 0
        total = normals.copy()
        for axis in range(3):
            total[:, axis] += np.bincount(begin, agrees * normals[end, axis], len(normals))
        normals = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return replace(mesh, normals=normals[vertex].astype(np.float32))


def _edges(triangles: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the edges (E, 2) of the triangles, each in both directions, without duplicates."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.concatenate([sides, sides[:, ::-1]]), axis=0)
