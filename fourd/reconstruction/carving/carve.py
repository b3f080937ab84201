"""Carving of one frame: computes the visual hull from masks and spreads points evenly over its surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.reconstruction.carving.bounds import Bounds, empty_hull_error
from fourd.reconstruction.carving.excess import replace_excess
from fourd.reconstruction.carving.hull import Silhouettes
from fourd.reconstruction.carving.silhouette import Floats
from fourd.reconstruction.carving.surface import (
    choose_cell_side,
    move_inwards,
    project_to_surface,
    surface_cells,
    thin_evenly,
)


@dataclass(frozen=True, eq=False)
class CarvedFrame:
    """Points of one frame on or slightly below the surface of the visual hull.

    The points are in random order: for every M, the first M points are a uniform sample of the surface.

    Attributes:
        xyz: (N, 3) float32 world points.
        normals: (N, 3) float32 unit normals that point out of the hull.
        voxel_size: side length, in world units, of the smallest cells into which space was subdivided.
        spacing: mean distance between neighbouring points in world units.
    """

    xyz: NDArray[np.float32]
    normals: NDArray[np.float32]
    voxel_size: float
    spacing: float


def carve_frame(
    masks: Sequence[NDArray[np.uint8]],
    cameras: Sequence[Camera],
    bounds: Bounds,
    *,
    points: int = 65536,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    trim: bool = True,
    inset: float = 0.0,
    seed: int = 0,
    names: Sequence[str] | None = None,
    label: str = "masks",
) -> CarvedFrame:
    """Carve one frame's visual hull and spread points evenly over its surface.

    Cells are subdivided from coarse to fine, and cells that certainly contain no surface are dropped. The finest cells
    are so small that the number of cells that the surface intersects exceeds the requested number of points. The
    centres of these cells are moved onto the surface with an error of at most a tenth of a cell's side, and become the
    points. Finally, points are removed evenly until the requested number remains.

    Args:
        masks: mattes (H, W) uint8, one per camera; 255 is the object.
        cameras: undistorted pinhole cameras.
        bounds: search box, for example from :func:`find_bounds`.
        points: number of points to return, at least 1.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the silhouettes of at least
            this fraction of the views that see it. If 20 views see it, an agreement of 0.95 tolerates one wrong view.
        least_views: a fraction in (0, 1]. A point belongs to the hull only if it is seen by at least this fraction of
            all views and by at least 3 views. If there are only 2 views, both must see it.
        trim: whether to remove protruding parts of the hull; see :mod:`fourd.reconstruction.carving.excess`. The
            remaining hull still covers all silhouettes.
        inset: distance by which points are moved into the hull, as a multiple of :attr:`CarvedFrame.spacing`. In
            thin parts of the hull, points are moved less far.
        seed: seed of the random order of the points. Equal inputs and seeds give bitwise equal results.
        names: names of the cameras for error messages.
        label: name of the masks for error messages.

    Raises:
        UserError: if the hull is empty. The message names the 3 views that disagree most with the other views.
        ValueError: if the numbers or shapes of masks and cameras do not match, ``points`` is below 1, ``agreement`` or
            ``least_views`` is outside (0, 1], or ``inset`` is negative.
    """
    if points < 1:
        raise ValueError(f"points: expected at least 1, got {points}")
    if inset < 0:
        raise ValueError(f"inset: expected 0 or more, got {inset}")
    origin = bounds.centre
    views = Silhouettes.from_masks(masks, cameras, origin, agreement=agreement, least_views=least_views)
    lower, upper = bounds.lower - origin, bounds.upper - origin
    size = choose_cell_side(views, lower, upper, points)
    xyz, normals = _surface_candidates(views, bounds, size, points)
    if len(xyz) == 0:
        raise empty_hull_error(views, float(bounds.extent.max()) / 2, names, label)
    if trim:
        xyz, normals = replace_excess(views, lower, upper, xyz, normals, size)
    xyz, normals, spacing = _thin(xyz, normals, size, points, seed)
    if inset > 0:
        xyz = move_inwards(views, xyz, normals, inset * spacing)
    return CarvedFrame((xyz + origin).astype(np.float32), normals, size, spacing)


def _thin(xyz: Floats, normals: Floats, size: float, points: int, seed: int) -> tuple[Floats, Floats, float]:
    """Choose at most ``points`` evenly spread candidates in random order, and compute their mean spacing."""
    chosen = thin_evenly(xyz, points, np.random.default_rng(seed))
    spacing = float(size * np.sqrt(len(xyz) / max(len(chosen), 1)))
    return xyz[chosen], normals[chosen], spacing


def _surface_candidates(views: Silhouettes, bounds: Bounds, size: float, points: int) -> tuple[Floats, Floats]:
    """Find surface points (N, 3) and their normals (N, 3), with N >= ``points`` if possible.

    The centres of cells near the surface are moved onto the surface. The cells have the side length ``size``. If they
    give too few points, the search is repeated with smaller cells, at most three times.
    """
    lower, upper = bounds.lower - views.origin, bounds.upper - views.origin
    xyz = normals = np.zeros((3, 0), dtype=np.float32)
    for _ in range(4 if size > 0 else 0):
        cells, distance, deciding = views.surface_slab(surface_cells(views, lower, upper, size), size)
        xyz, normals = project_to_surface(views, cells, distance, deciding, size)
        if xyz.shape[1] >= points or xyz.shape[1] == 0:
            break
        size *= 0.95 * float(np.sqrt(xyz.shape[1] / (1.4 * points)))
    return np.ascontiguousarray(xyz.T), np.ascontiguousarray(normals.T)
