"""Planes to try first: the large planes of triangulated points, and the triangles between neighbouring ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, KDTree, QhullError

from fourd.background.stereo.patches import Floats, Grid, index_intrinsics
from fourd.cameras import Camera

Array = NDArray[np.float64]

MOST_PLANES = 4
LEAST_INLIERS = 12
TRIES = 500
TOLERANCE = 0.003
"""Of the distance between the cameras and the points: how far from a plane a point may lie that supports it."""


def large_planes(xyz: Array, weights: Array, distance: float, rng: np.random.Generator) -> Array:
    """(P, 4) planes (n, d), n . x = d, that most of the points (N, 3) support, one after the other (RANSAC).

    Args:
        weights: (N,) what each point counts for; a plane has at least 12.
        distance: typical one from the cameras, world units.
    """
    left = np.ones(len(xyz), bool)
    planes: list[list[float]] = []
    while len(planes) < MOST_PLANES and left.sum() >= 3:
        points, counts = xyz[left], weights[left]
        a, b, c = points[rng.integers(0, len(points), (3, TRIES))]
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals[lengths > 0] / lengths[lengths > 0, None]
        offsets = (normals * a[lengths > 0]).sum(axis=1)
        near = np.abs(points @ normals.T - offsets) < TOLERANCE * distance
        support = counts @ near
        if not len(support) or support.max() < LEAST_INLIERS:
            break
        inliers = points[near[:, int(support.argmax())]]
        middle = inliers.mean(axis=0)
        normal = np.linalg.svd(inliers - middle)[2][2]
        planes.append([*normal, normal @ middle])
        left &= np.abs(xyz @ normal - normal @ middle) >= 3 * TOLERANCE * distance
    return np.array(planes).reshape(-1, 4)


def as_seen(plane: Array, camera: Camera, grid: Grid) -> Floats:
    """(N, 3) the world's plane (n, d) for all cells of a camera's picture."""
    normal = camera.rotation @ plane[:3]
    offset = plane[3] + normal @ camera.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        one = np.linalg.inv(index_intrinsics(camera)).T @ (normal / offset)
    return np.broadcast_to(one.astype(np.float32), grid.pixels.shape)


def triangles(xyz: Array, camera: Camera, grid: Grid) -> list[Floats]:
    """(N, 3) each, NaN for none: the plane of the three points (M, 3) about a cell, and the nearest point's depth."""
    pixels, depth = camera.project(xyz)
    pixels, depth = pixels[depth > 0] - 0.5, depth[depth > 0]
    if len(depth) == 0:
        return []
    level = np.zeros_like(grid.pixels)
    level[:, 2] = 1 / depth[KDTree(pixels).query(grid.pixels[:, :2])[1]]
    try:
        mesh = Delaunay(pixels)
    except (QhullError, ValueError):
        return [level]
    corners = np.concatenate([pixels[mesh.simplices], np.ones((len(mesh.simplices), 3, 1))], axis=2)
    flat = np.abs(np.linalg.det(corners)) < 1e-6
    corners[flat] = np.eye(3)
    planes = np.linalg.solve(corners, 1 / depth[mesh.simplices][..., None])[..., 0]
    planes[flat] = np.nan
    where = mesh.find_simplex(grid.pixels[:, :2].astype(np.float64))
    slanted = np.where(where[:, None] >= 0, planes[where], np.nan)
    return [slanted.astype(np.float32), level]
