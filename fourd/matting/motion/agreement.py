"""Multi-view consistency: a soft visual hull, carved for each view from the evidence of all other views.

The score of a cell is the smallest log-odds among the views that see it, or a higher order statistic with many views,
so that a few of them may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera

Floats = NDArray[np.float32]

MAX_CELLS = 112
"""Maximum number of cells along the box's longest side; 1.4 million in a cube."""
CELLS_PER_PIXEL = 1.0
OUTLIER_SHARE = 0.05
"""Share of the views that may be wrong about a cell."""
MIN_SEEING_SHARE = 0.75
"""Minimum share of the views that must see a cell."""
REJECT_LOG_ODDS = np.float32(-2.0)
"""Log-odds below which a view rejects a cell; most cells are dropped by it before sorting."""
NO_CELL_LOG_ODDS = np.float32(-9.0)
"""Log-odds of pixels without any cell."""


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """A grid of cells with their projections into each camera.

    Attributes:
        xyz: (N, 3) centres, world units.
        size: side of a cell, world units.
        cameras: cameras of the evidence.
        pixels: (C, N) int32, row * width + column of the centre in each camera; -1 where it is not seen.
        width_px: (C,) odd width of a cell's projection in each camera, pixels.
    """

    xyz: Array
    size: float
    cameras: tuple[Camera, ...]
    pixels: NDArray[np.int32]
    width_px: tuple[int, ...]

    @staticmethod
    def covering(lower: Array, upper: Array, cameras: Sequence[Camera], count: int | None = None) -> VoxelGrid:
        """A grid over a box with ``count`` cells along its longest side; None matches the pictures' resolution."""
        side = float((upper - lower).max())
        if count is None:
            middle = (lower + upper) / 2
            distances = [float(np.linalg.norm(camera.centre - middle)) for camera in cameras]
            focals = [camera.intrinsics[1, 1] for camera in cameras]
            side_px = side * max(focal / distance for focal, distance in zip(focals, distances, strict=True))
            count = int(np.clip(CELLS_PER_PIXEL * side_px, 16, MAX_CELLS))
        size = side / count
        axes = [np.arange(low + size / 2, high, size) for low, high in zip(lower, upper, strict=True)]
        xyz = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        return VoxelGrid.from_centres(xyz, size, cameras)

    @staticmethod
    def from_centres(xyz: Array, size: float, cameras: Sequence[Camera]) -> VoxelGrid:
        """Project cells with centres (N, 3) into the cameras."""
        pixels = np.full((len(cameras), len(xyz)), -1, np.int32)
        widths = []
        for index, camera in enumerate(cameras):
            position, depth = camera.project(xyz)
            column, row = np.floor(position[:, 0]), np.floor(position[:, 1])
            seen = (depth > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
            pixels[index, seen] = (row[seen] * camera.width + column[seen]).astype(np.int32)
            median = float(np.median(depth[seen])) if seen.any() else np.inf
            width = camera.intrinsics[1, 1] * size / median
            widths.append(2 * round((width - 1) / 2) + 1 if width > 1 else 1)
        return VoxelGrid(xyz, size, tuple(cameras), pixels, tuple(widths))

    def scores(self, evidence: Sequence[Floats]) -> Scores:
        """Score the cells from each camera's log-odds (h, w); positive = subject."""
        seen = (self.pixels >= 0).sum(axis=0)
        needed = max(2, int(np.ceil(MIN_SEEING_SHARE * len(self.cameras) - 1e-9)))
        outliers = min(int(OUTLIER_SHARE * len(self.cameras) + 1e-9), max(0, len(self.cameras) - 2))
        alive = np.flatnonzero(seen >= needed)
        rejections = np.zeros(len(alive), np.int16)
        values: list[Floats] = []
        for index, picture in enumerate(evidence):
            flat = dilate(picture, self.width_px[index]).ravel()
            pixels = self.pixels[index, alive]
            value = np.where(pixels >= 0, flat[np.maximum(pixels, 0)], -NO_CELL_LOG_ODDS)
            values.append(value)
            rejections += value < REJECT_LOG_ODDS
            keep = rejections <= outliers + 1
            if np.count_nonzero(keep) < 0.7 * len(keep):
                alive, rejections = alive[keep], rejections[keep]
                values = [kept[keep] for kept in values]
        keep = rejections <= outliers + 1
        stacked = np.stack([kept[keep] for kept in values])
        return Scores.from_evidence(self, alive[keep], stacked, outliers)

    def max_projection(self, chosen: NDArray[np.intp], values: Floats, index: int) -> Floats:
        """(h, w) largest value of the chosen cells (n,) per pixel of a camera; NO_CELL_LOG_ODDS without cells."""
        camera = self.cameras[index]
        flat = np.full(camera.width * camera.height, NO_CELL_LOG_ODDS, np.float32)
        pixels = self.pixels[index, chosen]
        seen = pixels >= 0
        np.maximum.at(flat, pixels[seen], values[seen])
        picture = flat.reshape(camera.height, camera.width)
        return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, _square(max(3, self.width_px[index]))), np.float32)


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of the cells that are not rejected.

    Attributes:
        grid: the grid.
        alive: (n,) indices of these cells.
        total: (n,) score from all views.
        leave_one_out: (C, n) score from all views except one.
    """

    grid: VoxelGrid
    alive: NDArray[np.intp]
    total: Floats
    leave_one_out: Floats

    @staticmethod
    def from_evidence(grid: VoxelGrid, alive: NDArray[np.intp], values: Floats, outliers: int) -> Scores:
        """Order statistics over the views of log-odds ``values`` (C, n), of which ``outliers`` may be wrong."""
        if len(values) == 1:
            return Scores(grid, alive, values[0], np.full_like(values, -NO_CELL_LOG_ODDS))
        lowest = np.sort(np.partition(values, outliers + 1, axis=0)[: outliers + 2], axis=0)
        total, following = lowest[outliers], lowest[outliers + 1]
        leave_one_out = np.where(values <= total, following, total)
        return Scores(grid, alive, total, leave_one_out)

    def prior(self, index: int) -> Floats:
        """(h, w) log-odds of camera ``index``'s pixels from the other views; NO_CELL_LOG_ODDS off their hull."""
        return self.grid.max_projection(self.alive, self.leave_one_out[index], index)

    def box(self) -> tuple[Array, Array] | None:
        """Corners of the bounding box of the cells with positive scores; None without such cells."""
        centres = self.grid.xyz[self.alive[self.total > 0]]
        if not len(centres):
            return None
        margin = 1.5 * self.grid.size
        return centres.min(axis=0) - margin, centres.max(axis=0) + margin


def dilate(picture: Floats, width: int) -> Floats:
    """Maximum filter over a square of ``width`` pixels: a cell may show the subject anywhere in its projection."""
    return picture if width <= 1 else np.asarray(cv2.dilate(picture, _square(width)), np.float32)


def _square(width: int) -> Picture:
    return np.ones((width, width), np.uint8)


Picture = NDArray[np.uint8]
