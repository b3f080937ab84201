"""Surfaces of several pictures to points: about one for every so many pixels of each picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.seeding.stereo.fusing import Surface

Array = NDArray[np.float64]

SAME_SURFACE = 0.05
"""Of the depth: points so near to a surface cover it."""
CHOICE = 4
"""Candidates for a point, at least: cells are divided until there are so many."""
HALVINGS = 12
FINEST_PX = 1.0
"""Side of the smallest squares."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Places on a picture's surface, best supported first.

    Attributes:
        xy: (M, 2) indices of pixels.
        xyz: (M, 3) world.
        support: (M,) other pictures that place it alike.
    """

    xy: Array
    xyz: Array
    support: NDArray[np.intp]


def samples(surfaces: Sequence[Surface], points: int) -> list[Samples]:
    """Places all over the surfaces: some for each wanted point, and one a pixel at most."""
    cells = sum(int(surface.known.sum()) for surface in surfaces)
    parts = max(1, int(np.ceil(np.sqrt(CHOICE * points / max(cells, 1)))))
    return [_samples(surface, min(parts, surface.depths.grid.stride)) for surface in surfaces]


def _samples(surface: Surface, parts: int) -> Samples:
    """``parts`` by ``parts`` places of each known cell."""
    depths = surface.depths
    cells = np.flatnonzero(surface.known)
    cells = cells[np.lexsort((-depths.scores[cells], -surface.support[cells]))]
    offsets = ((np.arange(parts) + 0.5) / parts - 0.5) * depths.grid.stride
    x, y = (axis.ravel() for axis in np.meshgrid(offsets, offsets))
    xy = depths.grid.pixels[cells, None, :2] + np.stack([x, y], axis=1)
    planes = depths.planes[cells, None]
    inverse = (planes[..., :2] * xy).sum(axis=2) + planes[..., 2]
    # A plane that is seen nearly edge on may reach infinity within its cell.
    sound = (inverse > 0.5 * depths.inverse_depth[cells, None]).ravel()
    flat = xy.reshape(-1, 2).astype(np.float64)
    size = (surface.camera.width, surface.camera.height)
    sound &= (flat >= -0.5).all(axis=1) & (flat < np.subtract(size, 0.5)).all(axis=1)
    flat = flat[sound]
    xyz = surface.world(flat, inverse.ravel()[sound].astype(np.float64))
    return Samples(flat, xyz, np.repeat(surface.support[cells], parts * parts)[sound])


def thinned(surfaces: Sequence[Surface], candidates: Sequence[Samples], points: int) -> list[NDArray[np.intp]]:
    """Which of each picture's samples to take: at most ``points`` in all, by the smallest cells that give no more.

    In every picture each square of so many pixels gets a point, unless one of another picture's lies on the surface
    there; so near things get more points, and what many pictures see gets no more than what one sees.
    """
    most = 2.0 * max(max(surface.camera.width, surface.camera.height) for surface in surfaces)
    chosen = _chosen(surfaces, candidates, FINEST_PX)
    if _count(chosen) <= points:
        return chosen
    low, high = np.log(FINEST_PX), np.log(most)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        found = _chosen(surfaces, candidates, float(np.exp(middle)))
        if _count(found) > points:
            low = middle
        else:
            high, chosen = middle, found
    return chosen


def _count(chosen: Sequence[NDArray[np.intp]]) -> int:
    return sum(len(rows) for rows in chosen)


def _chosen(surfaces: Sequence[Surface], candidates: Sequence[Samples], side: float) -> list[NDArray[np.intp]]:
    """Samples to take for squares of ``side`` pixels."""
    chosen: list[NDArray[np.intp]] = []
    for index, (surface, mine) in enumerate(zip(surfaces, candidates, strict=True)):
        squares = _Squares(side, int(surface.camera.width / side) + 1, int(surface.camera.height / side) + 1)
        covered = np.zeros(squares.rows * squares.columns, bool)
        for other, rows in zip(candidates[:index], chosen, strict=True):
            look = surface.look(other.xyz[rows])
            on_it = np.abs(look.ratio - 1) < SAME_SURFACE
            covered[squares.at(look.xy[on_it])] = True
        places = squares.at(mine.xy)
        free = np.flatnonzero(~covered[places])
        _, first = np.unique(places[free], return_index=True)
        chosen.append(free[first])
    return chosen


@dataclass(frozen=True)
class _Squares:
    """A picture in squares of so many pixels."""

    side: float
    columns: int
    rows: int

    def at(self, xy: Array) -> NDArray[np.intp]:
        """(M,) numbers of the squares of indices (M, 2); what a border cell has outside goes to the border's."""
        places = np.clip((xy + 0.5) / self.side, 0, (self.columns - 1, self.rows - 1)).astype(np.intp)
        return np.asarray(places[:, 1] * self.columns + places[:, 0], np.intp)
