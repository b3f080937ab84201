"""A spherical grid of directions around a point, and interpolation on this grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from fourd.base.cameras import Camera

Array = NDArray[np.float64]

CELL_DEG = 1.0
ROWS_PER_DEGREE = 4
"""Number of rows per degree of elevation in a fine grid. Fine rows are needed because the far half of a floor spans
only a few degrees if the grid's centre is low above the floor."""
FAR_QUANTILE = 0.8
"""A cell's distance is this quantile of the distances of its points. A high quantile selects the farthest surface and
ignores objects in front of it."""

DISTANCE_WEIGHT = 100.0
"""Weight of horizontal neighbours in the extrapolation of distances, relative to the weight 1 of vertical neighbours.
With a large weight, the distances in a row are continued along this row, that is, at a constant elevation. A floor
stays horizontal, because a horizontal plane has the same distance in all directions of a row. A wall stays vertical,
because its known edge has the same horizontal distance from the grid's centre in all rows, and each row continues this
distance."""


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """A grid of directions around a point. Each row has one elevation, and each column one azimuth.

    Attributes:
        centre: (3,) world point at which the directions start.
        R_world_sphere: (3, 3) rotation from the grid's axes to the world. The third axis of the grid points up.
        rows: number of rows.
        columns: number of columns.
    """

    centre: Array
    R_world_sphere: Array
    rows: int
    columns: int

    def cells(self, xyz: Array) -> tuple[NDArray[np.intp], Array]:
        """Compute the flat indices (N,) of the cells that contain world points (N, 3), and the points' distances (N,)
        from the centre."""
        local = (xyz - self.centre) @ self.R_world_sphere
        distance = np.maximum(np.linalg.norm(local, axis=1), 1e-12)
        elevation = np.arcsin(np.clip(local[:, 2] / distance, -1, 1))
        azimuth = np.arctan2(local[:, 1], local[:, 0])
        row = np.clip(((elevation / np.pi + 0.5) * self.rows).astype(np.intp), 0, self.rows - 1)
        column = ((azimuth / (2 * np.pi) + 0.5) * self.columns).astype(np.intp) % self.columns
        return row * self.columns + column, distance

    def directions(self) -> Array:
        """Return unit vectors (rows * columns, 3) in world coordinates, one per cell. In even rows, a vector points to
        the centre of its cell. In odd rows, it points half a cell beside the centre, to the border of the next
        column."""
        return self.directions_at(*self.places(np.arange(self.rows * self.columns)))

    def places(self, cells: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the rows (N,) and columns (N,), as floats, of the cells with the flat indices ``cells`` (N,). In odd
        rows, 0.5 is added to the column, so that the directions of successive rows are not aligned."""
        row, column = (index.astype(np.float64) for index in np.divmod(cells, self.columns))
        return row, column + np.where(row % 2 == 1, 0.5 * (1 - 1e-9), 0.0)

    def directions_at(self, row: Array, column: Array) -> Array:
        """Compute unit vectors (N, 3) in world coordinates at fractional rows (N,) and columns (N,). Integer values are
        the centres of cells."""
        e = ((row + 0.5) / self.rows - 0.5) * np.pi
        a = ((column + 0.5) / self.columns - 0.5) * 2 * np.pi
        local = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
        return np.asarray(local @ self.R_world_sphere.T)


def direction_grid(cameras: Sequence[Camera], centre: Array, rows_per_degree: int = 1) -> DirectionGrid:
    """Create a grid around a world point (3,) with one column per degree. Its up direction is the cameras' mean up
    direction. For a fine grid, pass ``rows_per_degree = ROWS_PER_DEGREE``."""
    up = -np.sum([camera.rotation[1] for camera in cameras], axis=0)
    up = up / max(float(np.linalg.norm(up)), 1e-12) if np.linalg.norm(up) > 1e-6 else np.array([0.0, 0.0, 1.0])
    side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    side /= np.linalg.norm(side)
    half = round(180 / CELL_DEG)
    axes = np.column_stack([side, np.cross(up, side), up])
    return DirectionGrid(np.asarray(centre, np.float64), axes, rows_per_degree * half, 2 * half)


def summarize_cells(
    cells: NDArray[np.intp], distance: Array, rgb: NDArray[np.uint8], count: int
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Compute a distance and a colour for each of ``count`` cells from N points with cell indices ``cells`` (N,),
    distances ``distance`` (N,) and colours ``rgb`` (N, 3).

    Returns:
        known: (count,) bool, true for cells with points.
        inverse: (count,) inverse of the cell's distance, or 0 in cells without points. A cell's distance is the
            quantile FAR_QUANTILE of the distances of its points.
        rgb: (count, 3) mean colour of the cell's points at or beyond the cell's distance.
    """
    order = np.lexsort((distance, cells))
    sorted_cells = cells[order]
    starts = np.searchsorted(sorted_cells, np.arange(count + 1))
    sizes = np.diff(starts)
    known = sizes > 0
    inverse = np.zeros(count)
    first = starts[:-1] + np.floor(FAR_QUANTILE * (sizes - 1).clip(min=0)).astype(np.intp)
    inverse[known] = 1 / distance[order[first[known]]]
    far = np.arange(len(order)) >= first[sorted_cells]
    total = np.zeros((count, 3))
    np.add.at(total, sorted_cells[far], rgb[order[far]].astype(np.float64))
    return known, inverse, total / np.maximum(np.bincount(sorted_cells[far], minlength=count), 1)[:, None]


def fit_distances(grid: DirectionGrid, xyz: Array) -> Array:
    """Return the inverse distance (cells,) of the farthest surface in each direction, from points (N, 3) on surfaces.

    Directions without points continue the surfaces beside them, mainly in the horizontal direction.
    """
    cells, distance = grid.cells(xyz)
    no_colours = np.zeros((len(xyz), 3), np.uint8)
    known, inverse, _ = summarize_cells(cells, distance, no_colours, grid.rows * grid.columns)
    return extrapolate_distances(grid, known, inverse)


def interpolate_harmonic(
    grid: DirectionGrid, known: NDArray[np.bool_], values: Array, horizontal_weight: float
) -> Array:
    """Interpolate harmonically: each unknown cell gets the weighted mean of its neighbours' values.

    Args:
        grid: the grid of directions.
        known: (cells,) bool, true for cells with a given value. Given values are not changed.
        values: (cells, C) values. The values of unknown cells are ignored.
        horizontal_weight: weight of a horizontal neighbour at a distance of one degree. A vertical neighbour at a
            distance of one degree has weight 1.
    """
    width_over_height = grid.rows * CELL_DEG / 180
    horizontal_weight /= width_over_height**2
    number = np.arange(grid.rows * grid.columns).reshape(grid.rows, grid.columns)
    level = (number.ravel(), np.roll(number, -1, axis=1).ravel())
    down = (number[:-1].ravel(), number[1:].ravel())
    first, second = (np.concatenate([level[k], down[k]]) for k in (0, 1))
    weight = np.concatenate([np.full(len(level[0]), horizontal_weight), np.ones(len(down[0]))])
    count = number.size
    links = sparse.coo_matrix((weight, (first, second)), (count, count)).tocsr()
    links = links + links.T
    free = np.flatnonzero(~known)
    laplacian = sparse.diags(np.asarray(links.sum(axis=1)).ravel()) - links
    system = laplacian[free][:, free].tocsc()
    right = -laplacian[free][:, np.flatnonzero(known)] @ values[known]
    # The system is symmetric and diagonally dominant, so that it needs no pivots. With the ordering for such systems,
    # the factors have about half as many entries as with the default ordering.
    solver = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    out = values.copy()
    out[free] = np.column_stack([solver.solve(right[:, channel]) for channel in range(values.shape[1])])
    return out


def extrapolate_distances(grid: DirectionGrid, known: NDArray[np.bool_], inverse_distance: Array) -> Array:
    """Extrapolate inverse distances (cells,) from the known cells to all others, mainly in the horizontal direction.
    The mask ``known`` (cells,) is true for known cells."""
    if known.all():
        return inverse_distance
    return interpolate_harmonic(grid, known, inverse_distance[:, None], DISTANCE_WEIGHT)[:, 0]
