"""Removal of the visual hull's excess parts: protrusions that are not needed to cover the silhouettes.

The visual hull is the largest shape that agrees with all silhouettes. It protrudes from the object in directions
between those of the views, and in concave regions, which no silhouette shows. Training often cannot remove these excess
parts, because they can have the correct colour in every view, like a white lump in front of a white chest.

First, the hull is filled with cells. Then cells are removed in several rounds. Each round removes the cells whose
neighbourhood is mostly empty. On each ray through a silhouette, however, the cell with the fullest neighbourhood is
kept, so that the remaining cells still cover all silhouettes. To find how full the neighbourhoods are, the grid of
cells is smoothed with a Gaussian. Repeated smoothing and thresholding moves a surface by its mean curvature (Merriman,
Bence and Osher 1994). Kolev and Cremers (2008) also search for a shape that has a small area and satisfies silhouette
constraints, but they solve a convex problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from fourd.base.cameras import Array
from fourd.base.processes.interrupts import DeferredInterrupt
from fourd.reconstruction.carving.hull import Silhouettes, refine, root_cells
from fourd.reconstruction.carving.silhouette import Floats, SilhouetteView, sample

CELLS_PER_THICKNESS = 6
"""Number of cells across the mean thickness of the hull. The mean thickness is the hull's volume divided by its surface
area. Cells are never smaller than the distance between points."""

MAX_GRID_CELLS = 1 << 24
"""Maximum number of cells of the grid that encloses the hull. Cells are enlarged if the grid would exceed it."""

SMOOTHING_CELLS = 3.0
"""Standard deviation, in cells, of the Gaussian that measures how full the neighbourhood of a cell is."""

MIN_FULLNESS = 0.48
"""A cell is removed if the filled fraction of its neighbourhood is below this value, unless it is kept for a ray
(see CRUMB_FULLNESS). On a flat surface, the neighbourhood of a cell is half full."""

MAX_ROUNDS = 12

RAY_CELLS = 0.7
"""Distance between neighbouring rays through a silhouette, in cells. On each ray, the cell with the fullest
neighbourhood is kept (see CRUMB_FULLNESS). With a larger distance, the kept cells would no longer cover the silhouette
up to its contour."""

CRUMB_FULLNESS = 0.5
"""The fullness of a cell is the filled fraction of its neighbourhood. Cells with a fullness below MIN_FULLNESS are
removed, except the cell with the largest fullness on each ray. This cell is kept if its fullness is at least the
fraction CRUMB_FULLNESS of the largest fullness on the adjacent rays.

A cell belongs only to the ray that passes nearest to the cell's centre. The rays are less than a cell apart, so some
rays pass between the centres of the object's cells. If such a ray has cells, they belong to excess parts in front of
the object or behind it. Such cells are not kept, because their fullness is too low."""

NEAR_CELLS = 1.3
"""A point belongs to a cell if its distance from the cell's centre is at most this multiple of the cell's side."""

SURFACE_SMOOTHING_CELLS = 1.2
"""Standard deviation, in cells, of the Gaussian that smooths the remaining cells before their surface is computed."""


@dataclass(frozen=True, eq=False)
class FilledHull:
    """Cells whose centres are inside the hull, on a regular grid. The cells at all borders of the grid are empty.

    Attributes:
        lower: (3,) centre of the grid's first cell, relative to the world point ``Silhouettes.origin``.
        side: side length of a cell in world units.
        shape: number of cells along each axis.
        cells: (N,) flat indices of the cells inside the hull.
    """

    lower: Array
    side: float
    shape: tuple[int, int, int]
    cells: NDArray[np.int64]

    def centres(self, cells: NDArray[np.int64]) -> Floats:
        """Return the centres (M, 3) of the cells with the given flat indices (M,)."""
        index = np.stack(np.unravel_index(cells, self.shape), axis=1)
        return (self.lower + index * self.side).astype(np.float32)

    def smoothed(self, cells: NDArray[np.int64], sigma_cells: float) -> Floats:
        """Return an array with the grid's shape that is 1 in the cells with the flat indices ``cells`` (M,) and 0
        elsewhere, smoothed with a Gaussian."""
        values = np.zeros(self.shape, np.float32)
        values.ravel()[cells] = 1
        reach = int(3 * sigma_cells + 0.5)
        weights = cv2.getGaussianKernel(2 * reach + 1, sigma_cells, cv2.CV_32F)
        unit = np.ones(1, np.float32)
        for plane in values:
            cv2.sepFilter2D(plane, -1, weights, weights, dst=plane, borderType=cv2.BORDER_CONSTANT)
        rows = values.reshape(self.shape[0], -1)
        smooth = cv2.sepFilter2D(rows, -1, unit, weights, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(smooth, np.float32).reshape(self.shape)


def replace_excess(
    views: Silhouettes, lower: Array, upper: Array, xyz: Floats, normals: Floats, size: float
) -> tuple[Floats, Floats]:
    """Remove the points on the hull's excess parts, which are protrusions that are not needed to cover the
    silhouettes, and add points on the surface of the remaining hull.

    Args:
        views: the silhouettes.
        lower, upper: (3,) corners of the search box, relative to the origin of ``views``.
        xyz: (N, 3) points on the hull's surface, relative to the origin of ``views``.
        normals: (N, 3) outward unit normals of the hull at the points.
        size: distance between neighbouring points in world units.

    Returns:
        the remaining and the added points (M, 3), and their outward unit normals (M, 3). The spacing of the added
        points is ``size``.
    """
    thickness = float(np.einsum("ni,ni->n", xyz - xyz.mean(axis=0), normals).mean()) / 3
    if thickness <= 0:
        return xyz, normals
    hull = fill_hull(views, lower, upper, max(thickness / CELLS_PER_THICKNESS, size))
    remaining = remove_excess(views, hull)
    removed = np.setdiff1d(hull.cells, remaining, assume_unique=True)
    if len(removed) == 0:
        return xyz, normals
    near = NEAR_CELLS * hull.side
    is_excess = _is_near(xyz, hull.centres(removed), near) & ~_is_near(xyz, hull.centres(remaining), near)
    new_xyz, new_normals = _surface_inside_hull(views, hull, remaining, size)
    is_new = ~_is_near(new_xyz, xyz[~is_excess], size)
    return np.concatenate([xyz[~is_excess], new_xyz[is_new]]), np.concatenate(
        [normals[~is_excess], new_normals[is_new]]
    )


def fill_hull(views: Silhouettes, lower: Array, upper: Array, side: float) -> FilledHull:
    """Fill the hull inside a box with cells of side length ``side``. If the grid would have too many cells, the side
    length is increased."""
    levels = max(0, int(np.log2(max(float((upper - lower).max()) / side / 6, 1))))
    coarse = side * 2**levels
    cells = root_cells(lower, upper, coarse)
    for _ in range(levels):
        finer, finer_side = refine(cells[:, views.may_contain_object(cells, coarse)], coarse)
        if finer.size == 0 or _grid_cells(finer, finer_side) > MAX_GRID_CELLS:
            break
        cells, coarse = finer, finer_side
    cells = cells[:, views.distance(cells)[0] >= 0]
    border = int(np.ceil(3 * SMOOTHING_CELLS)) + 1
    if cells.size == 0:
        return FilledHull(lower, coarse, (1, 1, 1), np.zeros(0, np.int64))
    first = cells.min(axis=1).astype(np.float64) - border * coarse
    index = np.rint((cells - first[:, None]) / coarse).astype(np.int64)
    x, y, z = (int(length) + border + 1 for length in index.max(axis=1))
    return FilledHull(first, coarse, (x, y, z), np.ravel_multi_index(tuple(index), (x, y, z)))


def _grid_cells(cells: Floats, side: float) -> float:
    """Return the number of cells of the smallest grid that contains the cells with the centres (3, N)."""
    return float(np.prod(np.ptp(cells.astype(np.float64), axis=1) / side + 6 * SMOOTHING_CELLS))


def remove_excess(views: Silhouettes, hull: FilledHull) -> NDArray[np.int64]:
    """Remove the hull's excess parts, which are protrusions that are not needed to cover the silhouettes. Returns the
    flat indices (M,) of the remaining cells."""
    centres = np.ascontiguousarray(hull.centres(hull.cells).T)
    rays = [_rays_of_cells(view, centres, hull.side) for view in views.views]
    alive = np.arange(len(hull.cells))
    for _ in range(MAX_ROUNDS):
        fullness = hull.smoothed(hull.cells[alive], SMOOTHING_CELLS).ravel()[hull.cells[alive]]
        is_kept = fullness >= MIN_FULLNESS
        for ray, shape in rays:
            seen = np.flatnonzero(ray[alive] >= 0)
            ray_of_seen = ray[alive[seen]]
            best = np.zeros(shape, np.float32)
            np.maximum.at(best.ravel(), ray_of_seen, fullness[seen])
            nearby = cv2.dilate(best, np.ones((3, 3), np.uint8))
            least = np.maximum(best, CRUMB_FULLNESS * nearby).ravel()
            is_kept[seen] |= fullness[seen] >= least[ray_of_seen]
        if is_kept.mean() > 0.9995:
            break
        alive = alive[is_kept]
    return hull.cells[alive]


def _rays_of_cells(view: SilhouetteView, centres: Floats, side: float) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return, for each cell centre (3, N), the flat index of the ray through it in the view's grid of rays, and the
    shape (rows, columns) of this grid. The index is -1 if the centre projects outside the view's silhouette or
    image."""
    x, y, z = view.project(centres)
    is_inside = view.sees(x, y, z)
    is_inside[is_inside] = sample(view.distance, x[is_inside], y[is_inside], cv2.INTER_LINEAR) >= 0
    rays = np.full(centres.shape[1], -1, np.int64)
    if not is_inside.any():
        return rays, (1, 1)
    step_px = RAY_CELLS * side * view.focal / float(np.median(z[is_inside]))
    columns = np.floor(x[is_inside] / step_px).astype(np.int64)
    rows = np.floor(y[is_inside] / step_px).astype(np.int64)
    columns -= columns.min()
    rows -= rows.min()
    shape = int(rows.max()) + 1, int(columns.max()) + 1
    rays[is_inside] = rows * shape[1] + columns
    return rays, shape


def _surface_inside_hull(
    views: Silhouettes, hull: FilledHull, remaining: NDArray[np.int64], size: float
) -> tuple[Floats, Floats]:
    """Return points (M, 3) and outward normals (M, 3) on the surface of the remaining cells. Points near the hull's
    surface are left out, because that surface already has points. ``size`` is the distance between neighbouring
    points."""
    volume = hull.smoothed(remaining, SURFACE_SMOOTHING_CELLS)
    if float(volume.max(initial=0)) <= 0.5:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    trimesh = _import_trimesh()
    vertices, faces, _, _ = marching_cubes(volume, 0.5, gradient_direction="descent")
    mesh = trimesh.Trimesh(vertices * hull.side + hull.lower, faces, process=False)
    count = max(1, round(float(mesh.area) / size**2))
    xyz, face = trimesh.sample.sample_surface(mesh, count, seed=0)
    xyz = np.ascontiguousarray(xyz, np.float32)
    is_inside = views.distance(np.ascontiguousarray(xyz.T))[0] > NEAR_CELLS * hull.side
    return xyz[is_inside], np.ascontiguousarray(mesh.face_normals[face][is_inside], np.float32)


def _import_trimesh() -> ModuleType:
    """Import trimesh where it is needed, because this takes half a second. Ctrl-C is deferred, because trimesh catches
    every exception of its own imports, and would fail later."""
    with DeferredInterrupt() as interrupt:
        import trimesh
    if interrupt.is_pending:
        raise KeyboardInterrupt
    return trimesh


def _is_near(xyz: Floats, others: Floats, distance: float) -> NDArray[np.bool_]:
    """Return a bool array (N,) that is True for points (N, 3) within ``distance`` of one of the points ``others`` (M,
    3)."""
    if len(others) == 0 or len(xyz) == 0:
        return np.zeros(len(xyz), np.bool_)
    return np.isfinite(np.asarray(cKDTree(others).query(xyz, distance_upper_bound=distance)[0]))
