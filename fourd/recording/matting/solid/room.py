"""The room: how far the walls, the floor and the ceiling are from the middle of the cameras, in every direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from fourd.base.cameras import Array, Camera
from fourd.recording.stereo.directions import DirectionGrid, direction_grid, fit_distances

CELL_DEG = 4
"""Size of a cell of directions."""
SURROUND_CELLS = 5
"""Side of the square of cells whose median distance is the least distance of the cell in its middle. In a cell in which
only somebody in front of the wall was found, the wall is thus continued from the cells beside it."""


@dataclass(frozen=True, eq=False)
class Room:
    """The distance of the farthest surface in each direction from a point.

    Attributes:
        grid: the directions.
        inverse: (cells,) inverse distance of the surface in each direction.
    """

    grid: DirectionGrid
    inverse: NDArray[np.float64]

    @staticmethod
    def around(centre: Array, xyz: Array, cameras: Sequence[Camera]) -> Room:
        """Fit the room to points (N, 3) on all surfaces that the cameras see, among them objects inside the room."""
        fine = direction_grid(cameras, centre)
        grid = replace(fine, rows=fine.rows // CELL_DEG, columns=fine.columns // CELL_DEG)
        picture = fit_distances(grid, xyz).reshape(grid.rows, grid.columns)
        surround = median_filter(picture, SURROUND_CELLS, mode="wrap")
        return Room(grid, np.minimum(picture, surround).ravel())

    def depth_share(self, xyz: Array) -> Array:
        """Return each point's (N, 3) distance from the centre, as a fraction of the room's distance."""
        cells, distance = self.grid.cells(xyz)
        return np.asarray(distance * self.inverse[cells], np.float64)
