"""What the other views say of a pixel: a hull of soft evidence, carved from all but the pixel's own view.

A cell of space belongs to the subject as far as its least convinced views let it: the score is the smallest
log-odds among the views that see it or, where many do, the next smallest, so that a few may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera

Floats = NDArray[np.float32]

MOST_CELLS = 112
"""Cells along the box's longest side, at most; 1.4 million in a cube."""
CELLS_PER_PIXEL = 1.0
TOLERATED = 0.05
"""Share of the views that may be wrong about a cell."""
LEAST_SEEING = 0.75
"""Share of the views that must see a cell."""
VETO = np.float32(-2.0)
"""Log-odds below which a view denies a cell, so that most cells are dropped before they are sorted."""
NOWHERE = np.float32(-9.0)


@dataclass(frozen=True, eq=False)
class Cells:
    """A grid of cells and the pixels at which each camera sees their centres.

    Attributes:
        xyz: (N, 3) centres, world units.
        size: side of a cell, world units.
        cameras: of the pictures that evidence comes from.
        pixels: (C, N) int32, row * width + column in camera c's picture; -1 where it does not see the cell.
        reach_px: (C,) odd width in pixels of what a cell covers in each camera.
    """

    xyz: Array
    size: float
    cameras: tuple[Camera, ...]
    pixels: NDArray[np.int32]
    reach_px: tuple[int, ...]

    @staticmethod
    def filling(lower: Array, upper: Array, cameras: Sequence[Camera], count: int | None = None) -> Cells:
        """Cells that fill a box, ``count`` along its longest side; as fine as the pictures when None."""
        side = float((upper - lower).max())
        if count is None:
            middle = (lower + upper) / 2
            distances = [float(np.linalg.norm(camera.centre - middle)) for camera in cameras]
            focals = [camera.intrinsics[1, 1] for camera in cameras]
            shown_px = side * max(focal / distance for focal, distance in zip(focals, distances, strict=True))
            count = int(np.clip(CELLS_PER_PIXEL * shown_px, 16, MOST_CELLS))
        size = side / count
        axes = [np.arange(low + size / 2, high, size) for low, high in zip(lower, upper, strict=True)]
        xyz = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        return Cells.at(xyz, size, cameras)

    @staticmethod
    def at(xyz: Array, size: float, cameras: Sequence[Camera]) -> Cells:
        """Cells of given centres for these cameras."""
        pixels = np.full((len(cameras), len(xyz)), -1, np.int32)
        reach = []
        for index, camera in enumerate(cameras):
            place, depth = camera.project(xyz)
            column, row = np.floor(place[:, 0]), np.floor(place[:, 1])
            seen = (depth > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
            pixels[index, seen] = (row[seen] * camera.width + column[seen]).astype(np.int32)
            near = float(np.median(depth[seen])) if seen.any() else np.inf
            width = camera.intrinsics[1, 1] * size / near
            reach.append(2 * round((width - 1) / 2) + 1 if width > 1 else 1)
        return Cells(xyz, size, tuple(cameras), pixels, tuple(reach))

    def scores(self, evidence: Sequence[Floats]) -> Scores:
        """Score the cells by each camera's log-odds (h, w); positive = subject."""
        seen = (self.pixels >= 0).sum(axis=0)
        needed = max(2, int(np.ceil(LEAST_SEEING * len(self.cameras) - 1e-9)))
        tolerated = min(int(TOLERATED * len(self.cameras) + 1e-9), max(0, len(self.cameras) - 2))
        alive = np.flatnonzero(seen >= needed)
        denied = np.zeros(len(alive), np.int16)
        values: list[Floats] = []
        for index, picture in enumerate(evidence):
            flat = widened(picture, self.reach_px[index]).ravel()
            pixels = self.pixels[index, alive]
            value = np.where(pixels >= 0, flat[np.maximum(pixels, 0)], -NOWHERE)
            values.append(value)
            denied += value < VETO
            keep = denied <= tolerated + 1
            if np.count_nonzero(keep) < 0.7 * len(keep):
                alive, denied = alive[keep], denied[keep]
                values = [kept[keep] for kept in values]
        keep = denied <= tolerated + 1
        stacked = np.stack([kept[keep] for kept in values])
        return Scores.of(self, alive[keep], stacked, tolerated)

    def drawn(self, chosen: NDArray[np.intp], values: Floats, index: int) -> Floats:
        """(h, w) greatest value of the chosen cells (n,) over each pixel of a camera; NOWHERE where there is none."""
        camera = self.cameras[index]
        flat = np.full(camera.width * camera.height, NOWHERE, np.float32)
        pixels = self.pixels[index, chosen]
        seen = pixels >= 0
        np.maximum.at(flat, pixels[seen], values[seen])
        picture = flat.reshape(camera.height, camera.width)
        return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, _square(max(3, self.reach_px[index]))), np.float32)


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of the cells that are not out of the question.

    Attributes:
        cells: the grid.
        alive: (n,) indices of these cells.
        total: (n,) score by all views.
        without: (C, n) score by all views but one.
    """

    cells: Cells
    alive: NDArray[np.intp]
    total: Floats
    without: Floats

    @staticmethod
    def of(cells: Cells, alive: NDArray[np.intp], values: Floats, tolerated: int) -> Scores:
        """Order statistics over the views of ``values`` (C, n), of which ``tolerated`` may be wrong."""
        if len(values) == 1:
            return Scores(cells, alive, values[0], np.full_like(values, -NOWHERE))
        lowest = np.sort(np.partition(values, tolerated + 1, axis=0)[: tolerated + 2], axis=0)
        total, following = lowest[tolerated], lowest[tolerated + 1]
        without = np.where(values <= total, following, total)
        return Scores(cells, alive, total, without)

    def prior(self, index: int) -> Floats:
        """(h, w) log-odds that the other views give camera ``index``'s pixels; NOWHERE off their hull."""
        return self.cells.drawn(self.alive, self.without[index], index)

    def box(self) -> tuple[Array, Array] | None:
        """Corners of the box of the cells that the views take for the subject's; None where there are none."""
        centres = self.cells.xyz[self.alive[self.total > 0]]
        if not len(centres):
            return None
        margin = 1.5 * self.cells.size
        return centres.min(axis=0) - margin, centres.max(axis=0) + margin


def widened(picture: Floats, width: int) -> Floats:
    """Each pixel's greatest value within a square of ``width`` pixels: what a cell covers may be of the subject."""
    return picture if width <= 1 else np.asarray(cv2.dilate(picture, _square(width)), np.float32)


def _square(width: int) -> Picture:
    return np.ones((width, width), np.uint8)


Picture = NDArray[np.uint8]
