"""Joins separate triangles into a closed mesh: the zero level set of a signed distance function, which is computed from
the triangles' planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from fourd.base.cameras import Array, Camera
from fourd.reconstruction.carving.hull import Silhouettes
from fourd.reconstruction.meshes.fitting.hull_distance import surface_band
from fourd.reconstruction.meshes.surface.components import drop_crumbs
from fourd.reconstruction.meshes.surface.grid import TetrahedralGrid, cube_grid
from fourd.reconstruction.meshes.surface.marching import marching_tetrahedra
from fourd.reconstruction.meshes.triangle_fitting.neighbours import unit_normals
from fourd.reconstruction.meshes.views import clip_positions
from fourd.rendering.ops.meshes.ids import decode_ids
from fourd.rendering.triangles import rasterize

NEAREST = 12
"""Number of nearest triangles from which a point's signed distance is computed."""
SMOOTHING_CELLS = 1.0
"""Standard deviation of the triangles' Gaussian weights, in units of the side of the grid's cubes."""
LEAST_SHARE = 1e-3
"""Minimum absolute value of signed distances, in units of the side of the grid's cubes. Distances closer to 0 are
replaced by this positive value, because distances of 0 would produce triangles without area."""


@dataclass(frozen=True, eq=False)
class OrientedPoints:
    """Centres and normals of visible triangles.

    Attributes:
        xyz: (N, 3) float64 centres in world units.
        normals: (N, 3) float64 unit normals. Of the triangle's two sides, the normal points to the one that more pixels
            show.
        weights: (N,) float64 number of pixels that show the triangle, summed over all views, always positive.
    """

    xyz: Array
    normals: Array
    weights: Array


@torch.no_grad()
def visible_points(corners: Tensor, cameras: Sequence[Camera]) -> OrientedPoints:
    """Return the centres and normals of the visible triangles. ``corners`` (T, 3, 3) are the vertices of all triangles
    in world units. All triangles are drawn opaque, and a triangle is visible if at least one view shows it."""
    count = len(corners)
    xyz, tri = corners.reshape(-1, 3), torch.arange(3 * count, dtype=torch.int32).reshape(count, 3)
    centres, normals = corners.mean(dim=1), unit_normals(corners)
    pixels, facing = torch.zeros(count), torch.zeros(count)
    for camera in cameras:
        clip = clip_positions(xyz, camera)[None].contiguous()
        rast, _ = rasterize(clip, tri, (camera.height, camera.width), grad_db=False)
        index = decode_ids(rast[0, ..., 3]).long().flatten()
        seen = torch.bincount(index[index >= 0], minlength=count).float()
        towards = torch.from_numpy(camera.centre.astype(np.float32)) - centres
        pixels += seen
        facing += seen * torch.sign((towards * normals).sum(dim=1))
    kept = pixels > 0
    turned = torch.where(facing < 0, -1.0, 1.0)[:, None] * normals
    return OrientedPoints(*(value[kept].double().numpy() for value in (centres, turned, pixels)))


def connect_triangles(points: OrientedPoints, hull: Silhouettes, side: float) -> tuple[Tensor, Tensor]:
    """Make one closed mesh from oriented points.

    The mesh is the surface where a signed distance, positive inside, is 0. :func:`plane_distance` computes it at each
    grid vertex from the planes of the nearest triangles, whereas Hoppe et al. 1992 use only one plane per vertex. Where
    the signed distance to the visual hull is smaller, it is used instead, which keeps the mesh inside the hull.

    Args:
        points: oriented points, at least one.
        hull: silhouettes that define the visual hull.
        side: side length of the grid's cubes in world units.

    Returns:
        vertices (V, 3) float32 and triangles (M, 3) int32, counter-clockwise seen from outside; no triangles if there
        is no surface.
    """
    cubes, first = surface_band(points.xyz - hull.origin, (points.xyz - hull.origin)[0], side)
    placed = cube_grid(cubes, first, side)
    local = placed.xyz.numpy().astype(np.float64)
    distance = plane_distance(points, local + hull.origin, side)
    to_hull = hull.distance(np.ascontiguousarray(local.T.astype(np.float32)))[0]
    # The distance to the hull is clamped, because it is -inf at points that too few views see.
    distance = np.minimum(distance, to_hull.clip(-side, None))
    least = LEAST_SHARE * side
    sdf = torch.from_numpy(np.where(np.abs(distance) < least, least, distance).astype(np.float32))
    grid = TetrahedralGrid(
        placed.xyz + torch.from_numpy(hull.origin.astype(np.float32)), placed.tetrahedra, placed.is_border, side
    )
    surface = marching_tetrahedra(grid.xyz, sdf, grid.tetrahedra)
    xyz, triangles = drop_crumbs(*close_holes(surface.xyz.numpy(), surface.triangles.numpy()))
    return torch.from_numpy(np.ascontiguousarray(xyz)), torch.from_numpy(np.ascontiguousarray(triangles)).int()


def plane_distance(points: OrientedPoints, xyz: Array, side: float) -> NDArray[np.float64]:
    """For each position of ``xyz`` (N, 3), return the weighted mean (N,) of its signed distances, positive inside, to
    the planes of the NEAREST nearest points. A point's weight is its weight in ``points`` times a Gaussian of its
    distance to the position."""
    tree = cKDTree(points.xyz)
    away, index = tree.query(xyz, k=min(NEAREST, len(points.xyz)))
    away, index = np.asarray(away).reshape(len(xyz), -1), np.asarray(index).reshape(len(xyz), -1)
    # The Gaussians are divided by that of the nearest point, because far from the surface they would all underflow to
    # 0.
    weight = np.exp(-(away**2 - away[:, :1] ** 2) / (2 * (SMOOTHING_CELLS * side) ** 2)) * points.weights[index]
    height = ((points.xyz[index] - xyz[:, None]) * points.normals[index]).sum(axis=2)
    return np.asarray((weight * height).sum(axis=1) / weight.sum(axis=1))


def close_holes(
    xyz: NDArray[np.float32], triangles: NDArray[np.integer]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Close the holes of an oriented mesh by joining each edge of a hole to the mean of the hole's vertices.

    Holes occur where a surface crosses the border of the grid.
    """
    faces = np.asarray(triangles, np.int64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = len(xyz)
    is_open = ~np.isin(edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0])
    if not is_open.any():
        return xyz, faces
    start, end = edges[is_open].T
    graph = coo_array((np.ones(len(start), np.bool_), (start, end)), shape=(count, count))
    label = connected_components(graph, directed=False)[1][start]
    hole = np.unique(label, return_inverse=True)[1]
    # An open edge belongs to only one triangle. At each vertex of a hole, as many open edges start as end. Every vertex
    # is therefore the start of an open edge, so the mean over the starts of all open edges includes every vertex.
    number = np.bincount(hole)
    centres = np.stack([np.bincount(hole, xyz[start, axis]) / number for axis in range(3)], axis=1)
    caps = np.stack([end, start, count + hole], axis=1)
    return np.concatenate([xyz, centres.astype(np.float32)]), np.concatenate([faces, caps])
