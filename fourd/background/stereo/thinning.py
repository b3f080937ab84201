"""Surfaces of several pictures to points: about one for every so many pixels of each picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.background.stereo.fusion import Surface

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

SAME_SURFACE = 0.05
"""Of the depth: points so near to a surface cover it."""
HALVINGS = 8
FINEST_PX = 1.0
"""Side of the smallest squares."""
CONTINUED = 0.05
"""Of the inverse depth: a plane that misses the cells on both sides by more leads over an edge."""
MOST_PARTS = 2
"""Of a square along an axis. As deep as they are wide, parts would close any gap, but the many points that lie behind
each other then show their upper halves alone: what is drawn on a floor moves up by half a point."""


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

    Every picture is laid out in squares of so many pixels; those of a surface seen at a grazing angle are halved, as a
    camera that stands higher looks into the gaps else. The middle of each is taken, where the picture (H, W) is
    ``seen`` and no place taken before lies on the surface there; so near things get more points, and what many pictures
    see gets no more than what one sees. What other pictures confirm is taken before what is guessed.
    """
    sloped = [_Sloped(surface, _slopes(surface)) for surface in surfaces]
    chosen = _chosen(sloped, seen, FINEST_PX, points)
    if _count(chosen) <= points:
        return chosen
    pixels = sum(surface.camera.width * surface.camera.height for surface in surfaces)
    low, high = np.log(FINEST_PX), np.log(max(np.sqrt(pixels / points), 2 * FINEST_PX))
    while _count(chosen := _chosen(sloped, seen, float(np.exp(high)), points)) > points:
        low, high = high, high + np.log(2)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        found = _chosen(sloped, seen, float(np.exp(middle)), points)
        if _count(found) > points:
            low = middle
        else:
            high, chosen = middle, found
    return chosen


def _count(chosen: Sequence[Samples]) -> int:
    return sum(len(places.xyz) for places in chosen)


@dataclass(frozen=True, eq=False)
class _Sloped:
    """A picture's surface with its slopes (N, 2), see :func:`_slopes`."""

    surface: Surface
    slopes: Array


def _chosen(sloped: Sequence[_Sloped], seen: Sequence[Bools], side: float, most: int) -> list[Samples]:
    """Places to take for squares of ``side`` pixels; some of them, once there are more than ``most``."""
    layouts = [_Layout.of(each, side) for each in sloped]
    candidates = [_middles(*each) for each in zip(sloped, seen, layouts, strict=True)]
    taken = [np.zeros(len(places.xyz), bool) for places in candidates]
    for confirmed in (True, False):
        for index, (each, layout, mine) in enumerate(zip(sloped, layouts, candidates, strict=True)):
            covered = np.zeros(layout.count, bool)
            for other, rows in zip(candidates, taken, strict=True):
                look = each.surface.look(other.xyz[rows])
                covered[layout.at(look.xy[np.abs(look.ratio - 1) < SAME_SURFACE])] = True
            free = ~covered[layout.at(mine.xy)]
            taken[index] |= free & ((mine.support > 0) == confirmed)
            if sum(int(rows.sum()) for rows in taken) > most:
                return [places.only(rows) for places, rows in zip(candidates, taken, strict=True)]
    return [places.only(rows) for places, rows in zip(candidates, taken, strict=True)]


def _middles(sloped: _Sloped, seen: Bools, layout: _Layout) -> Samples:
    """The middles of the parts of squares on known cells."""
    surface = sloped.surface
    xy = layout.middles()
    last = (surface.camera.width - 1, surface.camera.height - 1)
    cells = surface.depths.grid.cells_at(xy)
    on = (cells >= 0) & surface.known[cells]
    at_column, at_row = np.clip(np.rint(xy), 0, last).astype(np.intp).T
    on &= (xy > -0.5).all(axis=1) & (xy < np.add(last, 0.5)).all(axis=1)
    on &= seen[at_row, at_column]
    xy, cells = xy[on], cells[on]
    offset = xy - surface.depths.grid.pixels[cells, :2]
    inverse = surface.depths.inverse_depth[cells] * (1 + (sloped.slopes[cells] * offset).sum(axis=1))
    return Samples(xy, surface.world(xy, inverse), surface.support[cells])


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

    @property
    def columns(self) -> int:
        return int(np.ceil(self.width / self.side)) + 1

    @property
    def rows(self) -> int:
        return int(np.ceil(self.height / self.side))

    def corners(self) -> tuple[Array, Array]:
        """(N, 2) where squares begin and end within the picture, pixels."""
        column, row = (axis.ravel() for axis in np.meshgrid(np.arange(self.columns), np.arange(self.rows)))
        begins = np.stack([column * self.side - self._shift(row), row * self.side], axis=1)
        size = (self.width, self.height)
        return np.clip(begins, 0, size), np.clip(begins + self.side, 0, size)

    def at(self, xy: Array) -> NDArray[np.intp]:
        """(M,) numbers of the squares of indices (M, 2); what a border cell has outside goes to the border's."""
        row = np.clip((xy[:, 1] + 0.5) / self.side, 0, self.rows - 1).astype(np.intp)
        column = np.clip((xy[:, 0] + 0.5 + self._shift(row)) / self.side, 0, self.columns - 1).astype(np.intp)
        return np.asarray(row * self.columns + column, np.intp)

    def _shift(self, row: NDArray[np.intp]) -> Array:
        return np.asarray(row % 2 * (self.side / 2))


@dataclass(frozen=True, eq=False)
class _Layout:
    """Squares of a picture, cut into parts where its surface is steep.

    Attributes:
        squares: before they are cut.
        begins, ends: (N, 2) of the squares, pixels.
        parts: (N, 2) across and down.
        first: (N,) number of each square's first part.
        count: of parts in all.
    """

    squares: _Squares
    begins: Array
    ends: Array
    parts: NDArray[np.intp]
    first: NDArray[np.intp]
    count: int

    @staticmethod
    def of(sloped: _Sloped, side: float) -> _Layout:
        squares = _Squares(side, sloped.surface.camera.width, sloped.surface.camera.height)
        begins, ends = squares.corners()
        parts = _parts(sloped, (begins + ends) / 2 - 0.5)
        counts = parts.prod(axis=1)
        return _Layout(squares, begins, ends, parts, np.cumsum(counts) - counts, int(counts.sum()))

    def middles(self) -> Array:
        """(count, 2) indices."""
        square = np.repeat(np.arange(len(self.parts)), self.parts.prod(axis=1))
        number = np.arange(self.count) - self.first[square]
        place = np.stack([number % self.parts[square, 0], number // self.parts[square, 0]], axis=1) + 0.5
        size = self.ends[square] - self.begins[square]
        return np.asarray(self.begins[square] + size * place / self.parts[square] - 0.5)

    def at(self, xy: Array) -> NDArray[np.intp]:
        """(M,) numbers of the parts that indices (M, 2) lie in."""
        square = self.squares.at(xy)
        size = np.maximum(self.ends[square] - self.begins[square], np.finfo(float).tiny)
        place = (xy + 0.5 - self.begins[square]) / size * self.parts[square]
        across, down = np.clip(place, 0, self.parts[square] - 1).astype(np.intp).T
        return np.asarray(self.first[square] + down * self.parts[square, 0] + across, np.intp)


def _parts(sloped: _Sloped, xy: Array) -> NDArray[np.intp]:
    """(M, 2) parts across and down of squares about indices (M, 2): the root of how steep the surface is."""
    surface = sloped.surface
    cells = np.maximum(surface.depths.grid.cells_at(xy), 0)
    slopes = surface.camera.intrinsics[0, 0] * sloped.slopes[cells]
    parts = np.minimum(np.sqrt(np.hypot(1, slopes)), MOST_PARTS)
    return np.where(surface.known[cells][:, None], np.rint(parts), 1).astype(np.intp)


def _slopes(surface: Surface) -> Array:
    """(N, 2) relative change of the cells' inverse depth a pixel; 0 over an edge between near and far."""
    grid = surface.depths.grid
    inverse = np.maximum(surface.depths.inverse_depth, np.finfo(np.float32).tiny).astype(np.float64)
    slopes = surface.depths.planes[:, :2] / inverse[:, None]
    edge = np.zeros(grid.shape, bool)
    for axis, slope in ((1, slopes[:, 0]), (0, slopes[:, 1])):
        edge |= _misses(inverse.reshape(grid.shape), slope.reshape(grid.shape) * grid.stride, axis) > CONTINUED
    return np.where(edge.ravel()[:, None], 0.0, slopes)


def _misses(inverse: Array, change: Array, axis: int) -> Array:
    """(R, C) by how much planes miss the cells on both sides along an axis, at least, by ``inverse`` (R, C)."""
    least = np.full_like(inverse, np.inf)
    for step in (-1, 1):
        miss = np.abs(np.roll(inverse, -step, axis) / inverse - 1 - step * change)
        outer: list[slice | int] = [slice(None), slice(None)]
        outer[axis] = -1 if step == 1 else 0
        miss[tuple(outer)] = np.inf
        least = np.minimum(least, miss)
    return least if inverse.shape[axis] > 1 else np.zeros_like(inverse)
