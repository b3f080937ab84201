"""The signed distance to the visual hull, on a tetrahedral grid around the surface of the hull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from torch import Tensor

from fourd.base.cameras import Array, Camera
from fourd.reconstruction.carving.bounds import Bounds, empty_hull_error
from fourd.reconstruction.carving.excess import FilledHull, fill_hull, remove_excess
from fourd.reconstruction.carving.hull import Silhouettes
from fourd.reconstruction.carving.surface import surface_cells
from fourd.reconstruction.meshes.surface.grid import TetrahedralGrid, cube_grid

BAND_CELLS = 2
"""Number of cubes by which the grid extends, on each side, beyond the cubes that contain the surface of the hull."""

SMOOTHING_CELLS = 1.2
"""Standard deviation of the Gaussian in :class:`_RemovedParts`, in units of the cell size.

Excess parts are protrusions that are removed from the hull; the remaining hull still covers all mattes. The Gaussian
smooths the occupancy of the whole hull and the occupancy of the remaining hull. The difference between the two results
at a point is the fraction of the point's neighbourhood that was removed.
"""

DISTANCE_CELLS = 1.5
"""Signed distances are clamped to plus or minus this number of cube sides."""


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """A signed distance function on a tetrahedral grid.

    Attributes:
        grid: the grid, which covers a band of a few cubes around the surface.
        sdf: (V,) float32 signed distance of each vertex in world units, positive inside, with absolute values clamped
            to DISTANCE_CELLS cube sides.
    """

    grid: TetrahedralGrid
    sdf: Tensor


def hull_distance_grid(
    masks: Sequence[NDArray[np.uint8]],
    cameras: Sequence[Camera],
    bounds: Bounds,
    *,
    cells: int,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    trim: bool = True,
    names: Sequence[str] | None = None,
    label: str = "masks",
) -> DistanceGrid:
    """Compute the signed distance to the visual hull of one frame.

    Args:
        masks: mattes (H, W) uint8, one per camera; 255 is the object.
        cameras: undistorted pinhole cameras.
        bounds: box that contains the hull.
        cells: number of cubes along the longest side of ``bounds``, at least 1.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the mattes of at least this
            fraction of the views that see it.
        least_views: a fraction in (0, 1]. A point belongs to the hull only if it is seen by at least this fraction of
            all views.
        trim: whether to remove protruding parts of the hull (see :mod:`fourd.reconstruction.carving.excess`). The
            remaining hull still covers all mattes.
        names: names of the cameras for error messages.
        label: name of the masks for error messages.

    Raises:
        UserError: if the hull is empty. The error message names the views that disagree most with the other views.
        ValueError: if ``cells`` is below 1, or masks, cameras or fractions are invalid (see :class:`Silhouettes`).
    """
    if cells < 1:
        raise ValueError(f"cells: expected at least 1, got {cells}")
    views = Silhouettes.from_masks(masks, cameras, bounds.centre, agreement=agreement, least_views=least_views)
    lower, upper = bounds.lower - bounds.centre, bounds.upper - bounds.centre
    side = float(bounds.extent.max()) / cells
    removed = _removed_parts(views, lower, upper, side) if trim else None
    near = surface_cells(views, lower, upper, side)
    if near.shape[1]:
        near = near[:, np.abs(views.distance(near)[0]) <= 2 * side]
    if near.shape[1] == 0:
        raise empty_hull_error(views, float(bounds.extent.max()) / 2, names, label)
    centres = near if removed is None else np.concatenate([near, removed.surface], axis=1)
    cubes, first = surface_band(centres.T.astype(np.float64), near.T[0].astype(np.float64), side)
    grid = cube_grid(cubes, first, side)
    xyz = np.ascontiguousarray(grid.xyz.numpy().T)
    limit = DISTANCE_CELLS * side
    sdf = views.distance(xyz)[0].clip(-limit, limit)
    if removed is not None:
        sdf = (sdf - removed.depth(xyz, limit)).clip(-limit, limit)
    placed = TetrahedralGrid(
        grid.xyz + torch.from_numpy(bounds.centre.astype(np.float32)), grid.tetrahedra, grid.is_border, side
    )
    return DistanceGrid(placed, torch.from_numpy(sdf.astype(np.float32)))


@dataclass(frozen=True, eq=False)
class _RemovedParts:
    """The excess parts that were removed from a hull, on a regular grid of cells.

    Attributes:
        hull: the grid, and the cells that were inside the hull before the removal.
        share: float32 array with the shape of the grid. The value of a cell is the fraction, in [0, 1], of the cell's
            neighbourhood that lies in the excess parts. The neighbourhood has Gaussian weights; see SMOOTHING_CELLS.
        surface: (3, N) centres of the cells near the parts of the surface that the removal exposed, relative to
            ``Silhouettes.origin``.
    """

    hull: FilledHull
    share: NDArray[np.float32]
    surface: NDArray[np.float32]

    def depth(self, xyz: NDArray[np.float32], limit: float) -> NDArray[np.float32]:
        """Compute the amount (N,) by which the removed parts decrease the signed distance at points (3, N).

        Occupancy is 1 inside the hull and 0 outside. If it is smoothed with a Gaussian of standard deviation sigma
        (SMOOTHING_CELLS times the cell size), its slope at a flat surface is 1 / (sigma * sqrt(2 * pi)) per unit of
        distance. The removal decreases the smoothed occupancy at a point by ``share``, which is divided by this slope
        to get a distance. The result is at most ``2 * limit``, because signed distances are clamped to [-limit, limit]
        and cannot decrease by more.
        """
        index = (xyz.astype(np.float64) - self.hull.lower[:, None]) / self.hull.side
        share = map_coordinates(self.share, index, order=1, mode="nearest", prefilter=False)
        return np.asarray(share * (SMOOTHING_CELLS * self.hull.side * np.sqrt(2 * np.pi)), np.float32).clip(
            0, 2 * limit
        )


def _removed_parts(views: Silhouettes, lower: Array, upper: Array, side: float) -> _RemovedParts | None:
    """Find the hull's excess parts on a grid with cells of side length ``side``. Return None if there are none."""
    hull = fill_hull(views, lower, upper, side)
    if len(hull.cells) == 0:
        return None
    remaining = remove_excess(views, hull)
    if len(remaining) == len(hull.cells):
        return None
    rest = hull.smoothed(remaining, SMOOTHING_CELLS)
    share = hull.smoothed(hull.cells, SMOOTHING_CELLS) - rest
    is_surface = (np.abs(rest - 0.5) < 0.25) & (share > 1e-3)
    return _RemovedParts(hull, share, hull.centres(np.flatnonzero(is_surface)).T)


def surface_band(centres: Array, anchor: Array, side: float) -> tuple[NDArray[np.int64], Array]:
    """Find the cubes in a band around the points ``centres`` (P, 3). A cube is in the band if, along each axis, it is
    at most BAND_CELLS cubes away from a cube that contains one of the points.

    The cube lattice is placed such that ``anchor`` (3,) is the centre of a cube. Return the cubes' integer positions
    (N, 3), and the lower corner (3,) of the cube at (0, 0, 0), in the coordinates of ``centres``.
    """
    index = np.unique(np.rint((centres - anchor) / side).astype(np.int64), axis=0)
    reach = np.arange(-BAND_CELLS, BAND_CELLS + 1)
    steps = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    first = index.min(axis=0) - BAND_CELLS
    shape = index.max(axis=0) + BAND_CELLS + 1 - first
    band = np.zeros(shape, np.bool_)
    for step in steps:
        band[tuple((index + step - first).T)] = True
    return np.stack(np.nonzero(band), axis=1), anchor + (first - 0.5) * side
