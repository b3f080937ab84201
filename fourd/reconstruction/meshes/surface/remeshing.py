"""Isotropic remeshing with the optional library gpytoolbox."""

from __future__ import annotations

import importlib.util

import numpy as np
from numpy.typing import NDArray

ITERATIONS = 5


def remeshing_is_available() -> bool:
    """Return True if the optional package gpytoolbox is installed."""
    return importlib.util.find_spec("gpytoolbox") is not None


def remesh(
    xyz: NDArray[np.float32], triangles: NDArray[np.integer], edge_length: float
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Replace the triangles of a closed mesh by nearly equilateral triangles (Botsch and Kobbelt 2004).

    Long edges are split, short edges are collapsed, and edges are flipped. Vertices are smoothed in the tangent plane
    and then projected onto the given surface. The function is not differentiable.

    Args:
        xyz: (N, 3) finite vertices.
        triangles: (M, 3) vertex indices, at least one triangle.
        edge_length: target length of the edges in world units, more than 0.

    Returns:
        the vertices and triangles of the new mesh, with the orientation of the given mesh.

    Raises:
        ModuleNotFoundError: if gpytoolbox is not installed.
        ValueError: if ``edge_length`` is not positive, the mesh is empty or a vertex is not finite.
    """
    if not edge_length > 0:
        raise ValueError(f"edge_length: expected more than 0, got {edge_length}")
    if len(triangles) == 0:
        raise ValueError("triangles: expected at least one triangle, got none")
    if not np.isfinite(xyz).all():
        raise ValueError("xyz: expected finite vertices, got NaN or infinity")
    if not remeshing_is_available():
        raise ModuleNotFoundError(
            "expected the package gpytoolbox for remeshing, got none; pip install 'fourd[mesh]'", name="gpytoolbox"
        )
    from gpytoolbox import remesh_botsch

    vertices, faces = np.ascontiguousarray(xyz, np.float64), np.ascontiguousarray(triangles, np.int32)
    vertices, faces = remesh_botsch(vertices, faces, ITERATIONS, edge_length, True)
    return np.asarray(vertices, np.float32), np.asarray(faces, np.int64)
