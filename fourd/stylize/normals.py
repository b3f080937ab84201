"""Normals of the points of a scene, and their storage in two bytes.

A normal is the direction in which the neighbours of a point spread least (principal component analysis, Hoppe et al.
1992). It points to the side from which the capture's cameras see the point. Normals are then averaged over the
neighbours, because the noise of the positions would show as speckle in a drawing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS = 24
"""Neighbours of a point whose positions determine its normal."""
SMOOTHING_ROUNDS = 3
"""How often each normal is replaced by the mean of the normals around it."""
VOTING_ROUNDS = 4
"""How often a normal that contradicts most of its neighbours is reversed."""
_COARSE = 12
"""Side of the coarse grid that orients points that no camera sees, in cells per longest side of the scene."""

Points = NDArray[np.floating]
Normals = NDArray[np.float32]


def estimate_normals(xyz: Points, towards: Points | None = None) -> Normals:
    """Estimate unit normals that point out of the surface.

    Args:
        xyz: (N, 3) positions.
        towards: (N, 3) direction from which each point is seen, of any length, or 0 where it is not known. None means
            that no direction is known. The normals of such points point away from the centre of the points around them.

    Returns:
        (N, 3) float32. Fewer than 3 points have the normal (0, 0, 1).
    """
    count = len(xyz)
    if count < 3:
        return np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    positions = np.asarray(xyz, np.float32)
    near = np.asarray(cKDTree(positions).query(positions, k=min(NEIGHBOURS, count), workers=-1)[1])
    normals = _least_spread(positions, near)
    seen = np.zeros_like(normals) if towards is None else np.asarray(towards, np.float32)
    is_seen = (seen * seen).sum(1) > 0
    outwards = np.where(is_seen[:, None], seen, _away_from_centres(positions))
    normals *= _signs(normals, outwards)
    for _ in range(VOTING_ROUNDS):
        votes = np.einsum("nki,ni->n", normals[near], normals)
        normals[votes < 0] *= -1
    for _ in range(SMOOTHING_ROUNDS):
        # A neighbour on the other side of a thin part has the opposite normal, and does not count.
        around = normals[near]
        agrees = np.einsum("nki,ni->nk", around, normals) > 0
        normals = _unit(np.einsum("nki,nk->ni", around, agrees.astype(np.float32)), normals)
    return normals


def viewing_directions(xyz: Points, weights: Points, centres: Points) -> NDArray[np.float32]:
    """Mean direction from points to the cameras that see them, weighted by the blend weights.

    Args:
        xyz: (N, 3) positions. weights: (N, V), 0 where a camera does not see a point. centres: (V, 3) of the cameras.

    Returns:
        (N, 3), 0 where no camera sees the point.
    """
    total = np.zeros((len(xyz), 3), np.float32)
    for view, centre in enumerate(np.asarray(centres, np.float32)):
        ray = centre - np.asarray(xyz, np.float32)
        ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-12)
        total += weights[:, view, None].astype(np.float32) * ray
    return total


def encode_octahedral(normals: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Store unit normals (N, 3) as (N, 2) uint8: the bytes 127 x + 128 and 127 y + 128 of their points on an octahedron
    (Cigolle et al. 2014). The angle between a normal and the decoded normal is at most 1 degree."""
    length = np.abs(normals).sum(1, keepdims=True)
    plane = normals[:, :2] / np.maximum(length, 1e-12)
    folded = (1 - np.abs(plane[:, ::-1])) * np.where(plane >= 0, 1, -1)
    plane = np.where(normals[:, 2:] < 0, folded, plane)
    return (np.round(127 * plane) + 128).astype(np.uint8)


def decode_octahedral(stored: NDArray[np.uint8]) -> Normals:
    """The unit normals (N, 3) of :func:`encode_octahedral`."""
    plane = (stored.astype(np.float32) - 128) / 127
    z = 1 - np.abs(plane).sum(1, keepdims=True)
    plane = plane - np.where(plane > 0, 1, -1) * np.maximum(-z, 0)
    normals = np.concatenate([plane, z], axis=1)
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def _least_spread(positions: NDArray[np.float32], near: NDArray[np.intp]) -> Normals:
    centred = positions[near]
    centred -= centred.mean(1, keepdims=True)
    covariances = np.einsum("nki,nkj->nij", centred, centred)
    return np.ascontiguousarray(np.linalg.eigh(covariances)[1][:, :, 0])


def _away_from_centres(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Direction from the mean of the points in the 3 x 3 x 3 coarse cells around each point to the point."""
    lower = positions.min(0)
    side = max(float((positions.max(0) - lower).max()) / _COARSE, 1e-12)
    cells = np.minimum(((positions - lower) / side).astype(int), _COARSE - 1) + 1
    sums = np.zeros((*[_COARSE + 2] * 3, 4))
    np.add.at(sums, tuple(cells.T), np.concatenate([positions, np.ones((len(positions), 1))], 1))
    for axis in range(3):
        sums = sums + np.roll(sums, 1, axis) + np.roll(sums, -1, axis)
    around = sums[tuple(cells.T)]
    return (positions - around[:, :3] / around[:, 3:]).astype(np.float32)


def _signs(normals: Normals, directions: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.where((normals * directions).sum(1, keepdims=True) < 0, np.float32(-1), np.float32(1))


def _unit(vectors: NDArray[np.float32], fallback: Normals) -> Normals:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-6, vectors / np.maximum(length, 1e-6), fallback).astype(np.float32)
