"""Estimates the normals of a scene's points, and encodes them in two bytes.

A point's normal is the direction in which its neighbours spread least (principal component analysis, Hoppe et al.
1992). Of the two opposite directions, the normal is the one that points to the side from which the capture's cameras
see the point. On thin parts, such as the legs of an animal, the neighbours lie on all sides and do not determine the
normal, so each normal is rotated until it faces all cameras that see the point. Normals are then averaged over the
neighbours, because the noise of the positions would show as speckle in a drawing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.neighbours import nearest_neighbours

NEIGHBOURS = 24
"""Number of nearest points, including the point itself, whose positions determine its normal."""
SMOOTHING_ROUNDS = 3
"""Number of smoothing rounds, each of which replaces every normal by the mean of the normals around it."""
VOTING_ROUNDS = 4
"""Number of voting rounds, each of which reverses a normal if the sum of its dot products with the normals of its
nearest points is negative."""
VOTERS = 8
"""Number of nearest points, including the point itself, whose normals vote on a normal's sign. A larger number would
include points on the other side of thin parts."""
LEAST_COSINE = 0.1
"""Minimum cosine between a normal and the direction to a camera that sees the point."""
TURNING_ROUNDS = 2
"""Number of rounds in which each normal is rotated towards the cameras that see the point."""
_SEES = 0.3
"""A camera counts as seeing a point if its weight at the point (see :class:`Visibility`) is above this fraction of the
largest weight of any camera at the point. Smaller weights often belong to cameras that see the point through a gap
between other points."""
_COARSE = 12
"""Number of cells along the longest side of a coarse grid, which is used to find the outer side of surfaces that no
camera sees."""

Points = NDArray[np.floating]
Normals = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Visibility:
    """The cameras that see each point.

    Attributes:
        weights: (N, V) nonnegative weight of each camera at each point, for example the weight of the camera's image in
            the point's colour, which is blended from several images; 0 if the camera does not see the point.
        centres: (V, 3) camera centres.
    """

    weights: Points
    centres: Points

    def rays(self, xyz: NDArray[np.float32], view: int) -> NDArray[np.float32]:
        """Return the unit directions (N, 3) from points to the camera with index ``view``."""
        rays = np.asarray(self.centres[view], np.float32) - xyz
        return rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), np.float32(1e-12))

    def mean_directions(self, xyz: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the weighted sums (N, 3) of the unit directions to the cameras, which are 0 for points that no camera
        sees."""
        total = np.zeros((len(xyz), 3), np.float32)
        for view in range(len(self.centres)):
            total += self.weights[:, view, None].astype(np.float32) * self.rays(xyz, view)
        return total


def estimate_normals(xyz: Points, seen: Visibility | None = None) -> Normals:
    """Estimate unit normals that point out of the surface.

    Args:
        xyz: (N, 3) positions.
        seen: the cameras that see each point, or None if unknown. If ``seen`` is None or no camera sees a point, the
            point's normal points away from the mean position of the points around it.

    Returns:
        (N, 3) float32 normals, which are (0, 0, 1) if there are fewer than 3 points.
    """
    count = len(xyz)
    if count < 3:
        return np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    positions = np.asarray(xyz, np.float32)
    near = nearest_neighbours(positions, positions, min(NEIGHBOURS, count))[1]
    normals = _least_spread(positions, near)
    towards = np.zeros_like(normals) if seen is None else seen.mean_directions(positions)
    is_seen = (towards * towards).sum(1) > 0
    outwards = np.where(is_seen[:, None], towards, _away_from_centres(positions))
    normals *= _signs(normals, outwards)
    if seen is not None:
        normals = _turn_to_cameras(normals, positions, seen)
    for _ in range(VOTING_ROUNDS):
        votes = np.einsum("nki,ni->n", normals[near[:, :VOTERS]], normals)
        normals[votes < 0] *= -1
    for _ in range(SMOOTHING_ROUNDS):
        # Neighbours with opposite normals are on the other side of a thin part, and are ignored.
        around = normals[near]
        agrees = np.einsum("nki,ni->nk", around, normals) > 0
        normals = _unit(np.einsum("nki,nk->ni", around, agrees.astype(np.float32)), normals)
    return normals


def encode_octahedral(normals: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Encode unit normals (N, 3) as (N, 2) uint8 (Cigolle et al. 2014). Each normal is projected to a point (x, y) of
    an unfolded octahedron, and the stored bytes are 127 * x + 128 and 127 * y + 128. The angle between a normal and the
    decoded normal is at most 1 degree."""
    length = np.abs(normals).sum(1, keepdims=True)
    plane = normals[:, :2] / np.maximum(length, 1e-12)
    folded = (1 - np.abs(plane[:, ::-1])) * np.where(plane >= 0, 1, -1)
    plane = np.where(normals[:, 2:] < 0, folded, plane)
    return (np.round(127 * plane) + 128).astype(np.uint8)


def decode_octahedral(stored: NDArray[np.uint8]) -> Normals:
    """Decode the unit normals (N, 3) that :func:`encode_octahedral` has encoded."""
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


def _turn_to_cameras(normals: Normals, positions: NDArray[np.float32], seen: Visibility) -> Normals:
    """Rotate each normal towards the cameras that see its point, until the cosine between the normal and the direction
    to each of these cameras is at least about LEAST_COSINE."""
    least = _SEES * np.asarray(seen.weights, np.float32).max(1, initial=0)
    for _ in range(TURNING_ROUNDS):
        turned = normals
        for view in range(len(seen.centres)):
            rays = seen.rays(positions, view)
            missing = np.maximum(LEAST_COSINE - (turned * rays).sum(1), 0) * (seen.weights[:, view] > least)
            turned = (turned + missing[:, None] * rays).astype(np.float32)
        normals = _unit(turned, normals)
    return normals


def _away_from_centres(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the vector (N, 3) to each point from the mean position of all points in the 3 x 3 x 3 coarse cells around
    it."""
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
