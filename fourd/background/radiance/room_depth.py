"""Depths of what a single plate shows: the room's distance in each direction, continued along the horizon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.background.directions import Sphere, far_side, harmonic, sphere_about
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.patches import index_intrinsics
from fourd.cameras import Camera

Array = NDArray[np.float64]

ACROSS = 100.0
"""How much more alike a room's distances are along the horizon than up and down: so floors and walls stay such."""
ROWS_PER_DEGREE = 4
"""Seen from the middle of a low scene a floor's far half takes few degrees."""
NEAREST, FARTHEST = 0.02, 100.0
"""Of the cameras' distance from the middle: where a ray is followed."""
LEAST_KNOWN = 0.1
"""Of the plates' cells: of a room of which less is known much is chance, so that it is taken to be a hall at least."""
BEHIND = 1.5
"""Of the farthest camera's distance: where that hall's walls are."""
LOWEST = 2.0
"""Percentile of the measured heights that passes for the floor."""
STEPS = 32
HALVINGS = 8


@dataclass(frozen=True, eq=False)
class Room:
    """What lies around a point, all of it.

    Attributes:
        sphere: directions about the point.
        inverse_distance: (rows, columns) from the point to what is there; between cells it is interpolated.
    """

    sphere: Sphere
    inverse_distance: Array

    @staticmethod
    def around(surfaces: Sequence[Surface], centre: Array) -> Room | None:
        """What the known cells show about a world point (3,), elsewhere continued; None where none are known."""
        xyz = np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
        if not len(xyz):
            return None
        sphere = sphere_about([surface.camera for surface in surfaces], centre, ROWS_PER_DEGREE)
        cells, distance = sphere.cells(xyz)
        black = np.zeros((len(xyz), 3), np.uint8)
        known, inverse, _ = far_side(cells, distance, black, sphere.rows * sphere.columns)
        whole = inverse
        if not known.all():
            whole = harmonic(sphere, known, inverse[:, None], ACROSS / ROWS_PER_DEGREE**2)[:, 0]
        if np.mean([surface.known.mean() for surface in surfaces]) < LEAST_KNOWN:
            away = max(float(np.linalg.norm(surface.camera.centre - centre)) for surface in surfaces)
            low = float(np.percentile((xyz - centre) @ sphere.R_world_sphere[:, 2], LOWEST))
            whole = np.minimum(whole, _hall(sphere, BEHIND * away, max(-low, 0.0)))
        return Room(sphere, whole.reshape(sphere.rows, sphere.columns))

    def seen_by(self, surface: Surface) -> Array:
        """(N,) inverse depths for all cells of a camera's picture."""
        return self.inverse_depths(surface.camera, surface.depths.grid.pixels[:, :2].astype(np.float64))

    def inverse_depths(self, camera: Camera, xy: Array) -> Array:
        """(M,) one by the depth at which the rays of indices (M, 2) of pixels leave the room.

        Those that never are in it get one and a half times the camera's distance from its middle.
        """
        rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(index_intrinsics(camera)).T @ camera.rotation
        reach = max(float(np.linalg.norm(camera.centre - self.sphere.centre)), 1e-6)
        low, high = np.full(len(rays), BEHIND * reach), np.full(len(rays), BEHIND * reach)
        found, inside = np.zeros(len(rays), bool), np.zeros(len(rays), bool)
        before = NEAREST * reach
        for step in np.geomspace(NEAREST, FARTHEST, STEPS) * reach:
            outside = self._outside(camera.centre + step * rays)
            leaves = ~found & inside & outside
            low[leaves], high[leaves] = before, step
            found |= leaves
            inside, before = ~outside, step
        for _ in range(HALVINGS):
            middle = np.sqrt(low * high)
            outside = self._outside(camera.centre + middle[:, None] * rays) | ~found
            low, high = np.where(outside, low, middle), np.where(outside, middle, high)
        return np.asarray(1 / np.sqrt(low * high))

    def _outside(self, xyz: Array) -> NDArray[np.bool_]:
        """(M,) which world points are farther from the middle than what lies in their direction."""
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


def _hall(sphere: Sphere, radius: float, depth: float) -> Array:
    """(cells,) inverse distances of a ball about the middle, cut off by a floor so far below it."""
    down = -(sphere.directions() @ sphere.R_world_sphere[:, 2])
    return np.asarray(np.maximum(1 / radius, down / depth if depth > 0 else 0 * down))
