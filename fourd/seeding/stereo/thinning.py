"""Surfaces of several pictures to points: about one for every so many pixels of each picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.seeding.stereo.fusing import Surface

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

SAME_SURFACE = 0.05
"""Of the depth: points so near to a surface cover it."""
HALVINGS = 8
FINEST_PX = 1.0
"""Side of the smallest squares."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Places on a picture's surface.

    Attributes:
        xy: (M, 2) indices of pixels.
        xyz: (M, 3) world.
        support: (M,) other pictures that place it alike.
    """

    xy: Array
    xyz: Array
    support: NDArray[np.intp]

    def only(self, rows: Bools) -> Samples:
        return Samples(self.xy[rows], self.xyz[rows], self.support[rows])


def thinned(surfaces: Sequence[Surface], seen: Sequence[Bools], points: int) -> list[Samples]:
    """Places on each picture's surface: at most ``points`` in all, by the smallest squares that give no more.

    Every picture is laid out in squares of so many pixels. The middle of each is taken, where the picture (H, W) is
    ``seen`` and no place taken before lies on the surface in that square; so near things get more points, and what many
    pictures see gets no more than what one sees. What other pictures confirm is taken before what is guessed.
    """
    chosen = _chosen(surfaces, seen, FINEST_PX, points)
    if _count(chosen) <= points:
        return chosen
    pixels = sum(surface.camera.width * surface.camera.height for surface in surfaces)
    low, high = np.log(FINEST_PX), np.log(max(np.sqrt(pixels / points), 2 * FINEST_PX))
    while _count(chosen := _chosen(surfaces, seen, float(np.exp(high)), points)) > points:
        low, high = high, high + np.log(2)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        found = _chosen(surfaces, seen, float(np.exp(middle)), points)
        if _count(found) > points:
            low = middle
        else:
            high, chosen = middle, found
    return chosen


def _count(chosen: Sequence[Samples]) -> int:
    return sum(len(places.xyz) for places in chosen)


def _chosen(surfaces: Sequence[Surface], seen: Sequence[Bools], side: float, most: int) -> list[Samples]:
    """Places to take for squares of ``side`` pixels; some of them, once there are more than ``most``."""
    candidates = [_middles(surface, allowed, side) for surface, allowed in zip(surfaces, seen, strict=True)]
    taken = [np.zeros(len(places.xyz), bool) for places in candidates]
    for confirmed in (True, False):
        for index, (surface, mine) in enumerate(zip(surfaces, candidates, strict=True)):
            covered = np.zeros(_Squares.of(surface, side).count, bool)
            for other, rows in zip(candidates, taken, strict=True):
                look = surface.look(other.xyz[rows])
                covered[_Squares.of(surface, side).at(look.xy[np.abs(look.ratio - 1) < SAME_SURFACE])] = True
            free = ~covered[_Squares.of(surface, side).at(mine.xy)]
            taken[index] |= free & ((mine.support > 0) == confirmed)
            if sum(int(rows.sum()) for rows in taken) > most:
                return [places.only(rows) for places, rows in zip(candidates, taken, strict=True)]
    return [places.only(rows) for places, rows in zip(candidates, taken, strict=True)]


def _middles(surface: Surface, seen: Bools, side: float) -> Samples:
    """The middles of the squares on known cells."""
    xy = _Squares.of(surface, side).middles()
    last = (surface.camera.width - 1, surface.camera.height - 1)
    cells = surface.depths.grid.cells_at(xy)
    on = (cells >= 0) & surface.known[cells]
    at_column, at_row = np.clip(np.rint(xy), 0, last).astype(np.intp).T
    on &= (xy > -0.5).all(axis=1) & (xy < np.add(last, 0.5)).all(axis=1)
    on &= seen[at_row, at_column]
    xy, cells = xy[on], cells[on]
    inverse = (surface.depths.planes[cells] * np.column_stack([xy, np.ones(len(xy))])).sum(axis=1)
    # A plane that is seen nearly edge on may reach infinity within its cell.
    sound = inverse > 0.5 * surface.depths.inverse_depth[cells]
    xy, cells = xy[sound], cells[sound]
    return Samples(xy, surface.world(xy, inverse[sound]), surface.support[cells])


@dataclass(frozen=True)
class _Squares:
    """A picture in squares of so many pixels, every other row half a square to the left: so points cover best.

    Attributes:
        side: of a square, pixels.
        width, height: of the picture.
    """

    side: float
    width: int
    height: int

    @staticmethod
    def of(surface: Surface, side: float) -> _Squares:
        return _Squares(side, surface.camera.width, surface.camera.height)

    @property
    def columns(self) -> int:
        return int(np.ceil(self.width / self.side)) + 1

    @property
    def rows(self) -> int:
        return int(np.ceil(self.height / self.side))

    @property
    def count(self) -> int:
        return self.rows * self.columns

    def middles(self) -> Array:
        """(count, 2) indices, of a square on the border in the part inside."""
        column, row = (axis.ravel() for axis in np.meshgrid(np.arange(self.columns), np.arange(self.rows)))
        begins = np.stack([column * self.side - self._shift(row), row * self.side], axis=1)
        size = (self.width, self.height)
        return np.asarray((np.clip(begins, 0, size) + np.clip(begins + self.side, 0, size)) / 2 - 0.5)

    def at(self, xy: Array) -> NDArray[np.intp]:
        """(M,) numbers of the squares of indices (M, 2); what a border cell has outside goes to the border's."""
        row = np.clip((xy[:, 1] + 0.5) / self.side, 0, self.rows - 1).astype(np.intp)
        column = np.clip((xy[:, 0] + 0.5 + self._shift(row)) / self.side, 0, self.columns - 1).astype(np.intp)
        return np.asarray(row * self.columns + column, np.intp)

    def _shift(self, row: NDArray[np.intp]) -> Array:
        return np.asarray(row % 2 * (self.side / 2))
