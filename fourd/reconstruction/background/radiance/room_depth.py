"""A rough shape of the room that guides the extrapolation of depths.

The shape is stored as the distance of the surrounding surfaces from one point, the room's centre, for each direction.
Unknown distances are interpolated, mainly in the horizontal direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.stereo.directions import (
    ROWS_PER_DEGREE,
    DirectionGrid,
    direction_grid,
    fit_distances,
)
from fourd.recording.stereo.fusion import Surface
from fourd.recording.stereo.patches import index_intrinsics

Array = NDArray[np.float64]

NEAR, FAR = 0.02, 100.0
"""First and last depth of ray marching, as multiples of the camera's distance from the room's centre."""
MIN_KNOWN = 0.1
"""Minimum fraction of depth-map cells with known depth. Below it, the room's shape is unreliable. The room is then
enlarged such that it contains a large ball around its centre, apart from the part of the ball below the floor."""
HALL_RADIUS = 1.5
"""Radius of the ball that a room with an unreliable shape must contain, as a multiple of the farthest camera's distance
from the room's centre."""
FLOOR_PERCENTILE = 2.0
"""Percentile of the measured heights that is used as the floor height."""
STEPS = 32
BISECTION_STEPS = 8


@dataclass(frozen=True, eq=False)
class Room:
    """Rough shape of the room that the plates show, given by the distance from the room's centre to the surrounding
    surface in each direction.

    Attributes:
        sphere: the grid of directions around the centre.
        inverse_distance: (rows, columns) inverse distance to the surface. Between cell centres, values are interpolated
            bilinearly.
    """

    sphere: DirectionGrid
    inverse_distance: Array

    @staticmethod
    def from_surfaces(surfaces: Sequence[Surface], centre: Array) -> Room | None:
        """Create the room around the world point ``centre`` (3,) from the cells of ``surfaces`` whose depth is known.
        Returns None if there are no such cells."""
        xyz = np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
        if not len(xyz):
            return None
        sphere = direction_grid([surface.camera for surface in surfaces], centre, ROWS_PER_DEGREE)
        inverse_distance = fit_distances(sphere, xyz)
        if np.mean([surface.known.mean() for surface in surfaces]) < MIN_KNOWN:
            reach = max(float(np.linalg.norm(surface.camera.centre - centre)) for surface in surfaces)
            floor = float(np.percentile((xyz - centre) @ sphere.R_world_sphere[:, 2], FLOOR_PERCENTILE))
            hall = _hall_inverse_distance(sphere, HALL_RADIUS * reach, max(-floor, 0.0))
            inverse_distance = np.minimum(inverse_distance, hall)
        return Room(sphere, inverse_distance.reshape(sphere.rows, sphere.columns))

    def surface_inverse_depths(self, surface: Surface) -> Array:
        """Compute the room's inverse depths (N,) at all cells of a surface's depth map."""
        return self.inverse_depths(surface.camera, surface.depths.grid.pixels[:, :2].astype(np.float64))

    def inverse_depths(self, camera: Camera, xy: Array) -> Array:
        """Compute the inverse depths (M,) at which the rays through pixel indices (M, 2) leave the room.

        If a ray does not leave the room, for example because it never enters the room, its depth is set to 1.5 times
        the camera's distance from the room's centre.
        """
        rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(index_intrinsics(camera)).T @ camera.rotation
        reach = max(float(np.linalg.norm(camera.centre - self.sphere.centre)), 1e-6)
        low, high = np.full(len(rays), HALL_RADIUS * reach), np.full(len(rays), HALL_RADIUS * reach)
        found, inside = np.zeros(len(rays), bool), np.zeros(len(rays), bool)
        before = NEAR * reach
        for step in np.geomspace(NEAR, FAR, STEPS) * reach:
            outside = self._is_outside(camera.centre + step * rays)
            leaves = ~found & inside & outside
            low[leaves], high[leaves] = before, step
            found |= leaves
            inside, before = ~outside, step
        for _ in range(BISECTION_STEPS):
            middle = np.sqrt(low * high)
            outside = self._is_outside(camera.centre + middle[:, None] * rays) | ~found
            low, high = np.where(outside, low, middle), np.where(outside, middle, high)
        return np.asarray(1 / np.sqrt(low * high))

    def _is_outside(self, xyz: Array) -> NDArray[np.bool_]:
        """Return an (M,) bool mask of the world points that are farther from the room's centre than the surface in the
        same direction."""
        sphere = self.sphere
        local = (xyz - sphere.centre) @ sphere.R_world_sphere
        distance = np.maximum(np.linalg.norm(local, axis=1), 1e-12)
        row = (np.arcsin(np.clip(local[:, 2] / distance, -1, 1)) / np.pi + 0.5) * sphere.rows - 0.5
        column = (np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) + 0.5) * sphere.columns - 0.5
        row = np.clip(row, 0, sphere.rows - 1)
        i, j = row.astype(np.intp).clip(max=sphere.rows - 2), np.floor(column).astype(np.intp)
        down, right = row - i, column - j
        values, left, next_ = self.inverse_distance, j % sphere.columns, (j + 1) % sphere.columns
        upper = values[i, left] * (1 - right) + values[i, next_] * right
        lower = values[i + 1, left] * (1 - right) + values[i + 1, next_] * right
        return np.asarray(distance * (upper * (1 - down) + lower * down) > 1)


def _hall_inverse_distance(sphere: DirectionGrid, radius: float, depth: float) -> Array:
    """Compute the inverse distances (cells,) from the centre to the surface of a ball that is cut off at the floor,
    which is ``depth`` below the centre."""
    down = -(sphere.directions() @ sphere.R_world_sphere[:, 2])
    return np.asarray(np.maximum(1 / radius, down / depth if depth > 0 else 0 * down))
