"""Initial planes for PatchMatch: dominant planes of triangulated points, and planes through triangles of neighbouring
points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, KDTree, QhullError

from fourd.base.cameras import Camera
from fourd.recording.stereo.patches import Floats, Grid, index_intrinsics

Array = NDArray[np.float64]

MAX_PLANES = 4
MIN_INLIER_WEIGHT = 12
"""Minimum sum of the weights of a plane's inliers. The weights of points are an argument of
:func:`find_large_planes`."""
RANSAC_TRIALS = 500
PLANE_TOLERANCE = 0.003
"""Usual maximum distance of a plane's inliers from the plane, as a multiple of the typical distance between cameras and
points."""


def find_large_planes(xyz: Array, weights: Array, tolerance: float, rng: np.random.Generator) -> Array:
    """Find dominant planes of N points by sequential RANSAC.

    A plane is accepted only if the weights of its inliers sum to at least MIN_INLIER_WEIGHT.

    Args:
        xyz: (N, 3) world points.
        weights: (N,) weight of each point.
        tolerance: maximum distance of a plane's inliers from the plane in world units.
        rng: random generator.

    Returns:
        (P, 4) planes (n, d) with n . x = d in world coordinates, where P is at most MAX_PLANES.
    """
    remaining = np.ones(len(xyz), bool)
    planes: list[list[float]] = []
    while len(planes) < MAX_PLANES and remaining.sum() >= 3:
        points, counts = xyz[remaining], weights[remaining]
        a, b, c = points[rng.integers(0, len(points), (3, RANSAC_TRIALS))]
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals[lengths > 0] / lengths[lengths > 0, None]
        offsets = (normals * a[lengths > 0]).sum(axis=1)
        near = np.abs(points @ normals.T - offsets) < tolerance
        inlier_weights = counts @ near
        if not len(inlier_weights) or inlier_weights.max() < MIN_INLIER_WEIGHT:
            break
        inliers = points[near[:, int(inlier_weights.argmax())]]
        centroid = inliers.mean(axis=0)
        normal = np.linalg.svd(inliers - centroid, full_matrices=False)[2][2]
        planes.append([*normal, normal @ centroid])
        remaining &= np.abs(xyz @ normal - normal @ centroid) >= 3 * tolerance
    return np.array(planes).reshape(-1, 4)


def plane_in_view(plane: Array, camera: Camera, grid: Grid) -> Floats:
    """Convert a world plane (n, d) to the form described in :class:`Grid`. The result (N, 3) repeats the plane for the
    N cells of the camera's image."""
    normal = camera.rotation @ plane[:3]
    offset = plane[3] + normal @ camera.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        one = np.linalg.inv(index_intrinsics(camera)).T @ (normal / offset)
    return np.broadcast_to(one.astype(np.float32), grid.pixels.shape)


def triangle_planes(xyz: Array, camera: Camera, grid: Grid) -> list[Floats]:
    """Create planes from a Delaunay triangulation of the projections of points ``xyz`` (M, 3).

    Returns:
        up to two sets of planes (N, 3), with one plane per cell. In the first set, a cell's plane is the plane of the
        triangle that contains the cell, or NaN if there is none. In the second set, it is the fronto-parallel plane at
        the depth of the point that is nearest to the cell in the image.
    """
    pixels, depth = camera.project(xyz)
    pixels, depth = pixels[depth > 0] - 0.5, depth[depth > 0]
    if len(depth) == 0:
        return []
    fronto_parallel = np.zeros_like(grid.pixels)
    fronto_parallel[:, 2] = 1 / depth[KDTree(pixels).query(grid.pixels[:, :2])[1]]
    try:
        mesh = Delaunay(pixels)
    except (QhullError, ValueError):
        return [fronto_parallel]
    corners = np.concatenate([pixels[mesh.simplices], np.ones((len(mesh.simplices), 3, 1))], axis=2)
    degenerate = np.abs(np.linalg.det(corners)) < 1e-6
    corners[degenerate] = np.eye(3)
    planes = np.linalg.solve(corners, 1 / depth[mesh.simplices][..., None])[..., 0]
    planes[degenerate] = np.nan
    where = mesh.find_simplex(grid.pixels[:, :2].astype(np.float64))
    slanted = np.where(where[:, None] >= 0, planes[where], np.nan)
    return [slanted.astype(np.float32), fronto_parallel]
