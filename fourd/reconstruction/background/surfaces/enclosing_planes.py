"""Planes that bound a scene, such as floors and walls: the scene and the cameras lie on the same side of each plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.stereo.patches import Grid
from fourd.recording.stereo.plane_hypotheses import PLANE_TOLERANCE, find_large_planes, plane_in_view

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MAX_POINTS = 20_000
MIN_INLIERS = 0.05
"""Minimum number of points on a plane, as a fraction of all points. Planes with fewer points belong to small
objects."""
MAX_BEHIND = 0.01
"""Maximum number of points behind a plane, as a fraction of all points."""
TOLERANCE = 0.02
"""A point lies on a plane if its distance from the plane, divided by its distance from the mean camera centre, is at
most this value."""


@dataclass(frozen=True, eq=False)
class EnclosingPlanes:
    """Planes with almost no points behind them. Every camera ray ends at or before the nearest of these planes.

    Attributes:
        planes: (P, 4) planes (n, d) with n . x = d in world coordinates.
        middle: (3,) mean of the camera centres.
    """

    planes: Array
    middle: Array

    @staticmethod
    def from_points(xyz: Array, cameras: Sequence[Camera], rng: np.random.Generator) -> EnclosingPlanes:
        """Find planes with at least 5% of the world points ``xyz`` (N, 3) on them and at most 1% behind them."""
        centres = np.stack([camera.centre for camera in cameras])
        middle = centres.mean(axis=0)
        some = xyz[rng.permutation(len(xyz))[:MAX_POINTS]]
        found = []
        if len(some) >= 3:
            distances = np.linalg.norm(some - middle, axis=1)
            for plane in find_large_planes(
                some, np.ones(len(some)), PLANE_TOLERANCE * float(np.median(distances)), rng
            ):
                sides = centres @ plane[:3] - plane[3]
                before = np.sign(np.median(sides)) * (some @ plane[:3] - plane[3]) / np.maximum(distances, 1e-12)
                on, beyond = (np.abs(before) < TOLERANCE).mean(), (before < -TOLERANCE).mean()
                if on > MIN_INLIERS and beyond < MAX_BEHIND and (np.all(sides > 0) or np.all(sides < 0)):
                    found.append(plane)
        return EnclosingPlanes(np.array(found).reshape(-1, 4), middle)

    def contains(self, xyz: Array) -> Bools:
        """Return an (N,) bool mask of the world points (N, 3) that lie on one of the planes."""
        near = TOLERANCE * np.linalg.norm(xyz - self.middle, axis=1)
        return np.asarray((np.abs(xyz @ self.planes[:, :3].T - self.planes[:, 3]) < near[:, None]).any(axis=1))

    def inverse_depth(self, camera: Camera, grid: Grid) -> Array:
        """Compute the inverse depth (N,) of the nearest plane at the cells of a depth map, or 0 where the cell's ray
        hits no plane."""
        nearest = np.zeros(len(grid.pixels))
        for plane in self.planes:
            inverse = (plane_in_view(plane, camera, grid) * grid.pixels).sum(axis=1)
            nearest = np.maximum(nearest, np.where(np.isfinite(inverse), inverse, 0))
        return nearest
