"""Planes that enclose a scene: floors and walls that have all else on the cameras' side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.background.stereo.patches import Grid
from fourd.background.stereo.plane_hypotheses import as_seen, large_planes
from fourd.cameras import Camera

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_POINTS = 20_000
LEAST_ON = 0.05
"""Of the points; less is a table's edge."""
MOST_BEYOND = 0.01
NEAR = 0.02
"""Of a point's distance from the cameras: how far from a plane it may lie that belongs to it."""


@dataclass(frozen=True, eq=False)
class EnclosingPlanes:
    """Planes that nothing lies behind: what a picture shows ends at the nearest of them, if not before.

    Attributes:
        planes: (P, 4), n . x = d.
        middle: (3,) mean of the cameras' centres.
    """

    planes: Array
    middle: Array

    @staticmethod
    def of(xyz: Array, cameras: Sequence[Camera], rng: np.random.Generator) -> EnclosingPlanes:
        """The large planes of world points (N, 3) with at least 5% of them on it and at most 1% behind it."""
        centres = np.stack([camera.centre for camera in cameras])
        middle = centres.mean(axis=0)
        some = xyz[rng.permutation(len(xyz))[:MOST_POINTS]]
        found = []
        if len(some) >= 3:
            distances = np.linalg.norm(some - middle, axis=1)
            for plane in large_planes(some, np.ones(len(some)), float(np.median(distances)), rng):
                sides = centres @ plane[:3] - plane[3]
                before = np.sign(np.median(sides)) * (some @ plane[:3] - plane[3]) / np.maximum(distances, 1e-12)
                on, beyond = (np.abs(before) < NEAR).mean(), (before < -NEAR).mean()
                if on > LEAST_ON and beyond < MOST_BEYOND and (np.all(sides > 0) or np.all(sides < 0)):
                    found.append(plane)
        return EnclosingPlanes(np.array(found).reshape(-1, 4), middle)

    def on(self, xyz: Array) -> Bools:
        """(N,) which world points (N, 3) belong to a plane."""
        near = NEAR * np.linalg.norm(xyz - self.middle, axis=1)
        return np.asarray((np.abs(xyz @ self.planes[:, :3].T - self.planes[:, 3]) < near[:, None]).any(axis=1))

    def inverse_depth(self, camera: Camera, grid: Grid) -> Array:
        """(N,) one by the depth of the nearest plane in the cells of a picture, 0 where no plane is met."""
        nearest = np.zeros(len(grid.pixels))
        for plane in self.planes:
            inverse = (as_seen(plane, camera, grid) * grid.pixels).sum(axis=1)
            nearest = np.maximum(nearest, np.where(np.isfinite(inverse), inverse, 0))
        return nearest
