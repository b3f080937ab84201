"""Depth maps that agree: which cells several pictures place alike, and guesses for the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fourd.background.stereo.patches import index_intrinsics
from fourd.background.stereo.patchmatch import DepthMap
from fourd.cameras import Camera

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_SCORE = 0.6
SAME_DEPTH = 0.01
SAME_PLACE_PX = 1.5
BEFORE = 0.03
"""Of a depth: what lies so much nearer than a surface that is known would hide it, and cannot be there."""
ROUNDS = 3
SMALLEST_PATCH = 25
"""Cells: fewer that hang together are chance."""
CONTINUED = 0.03


@dataclass(frozen=True, eq=False)
class Surface:
    """A depth map, and what is known of its cells.

    Attributes:
        camera: pinhole of the map's picture.
        depths: planes of the cells.
        known: (N,) bool, cells whose plane counts.
        support: (N,) other pictures that place the cell's surface alike.
    """

    camera: Camera
    depths: DepthMap
    known: Bools
    support: NDArray[np.intp]

    def world(self, xy: Array, inverse_depth: Array) -> Array:
        """(M, 3) world points at indices (M, 2) of pixels."""
        rays = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(index_intrinsics(self.camera)).T
        return np.asarray((rays / inverse_depth[:, None] - self.camera.translation) @ self.camera.rotation, np.float64)

    def points(self, cells: NDArray[np.intp]) -> Array:
        """(M, 3) world points in the middle of cells (M,)."""
        xy = self.depths.grid.pixels[cells, :2].astype(np.float64)
        return self.world(xy, self.depths.inverse_depth[cells].astype(np.float64))

    def look(self, xyz: Array) -> Look:
        """Where world points (M, 3) lie in the picture, and the surface there."""
        pixels, depth = self.camera.project(xyz)
        xy = pixels - 0.5
        grid = self.depths.grid
        cells = np.where(depth > 0, grid.cells_at(xy), -1)
        inverse = (self.depths.planes[cells] * np.column_stack([xy, np.ones(len(xy))])).sum(axis=1)
        known = (cells >= 0) & self.known[cells]
        return Look(xy, cells, np.where(known, inverse * depth, np.nan), np.where(known, inverse, np.nan))


@dataclass(frozen=True, eq=False)
class Look:
    """World points as a picture has them.

    Attributes:
        xy: (M, 2) indices of pixels.
        cells: (M,) cells, -1 outside the picture.
        ratio: (M,) depth of the point by that of the known surface at its pixel; NaN where there is none.
        inverse_depth: (M,) of that surface.
    """

    xy: Array
    cells: NDArray[np.intp]
    ratio: Array
    inverse_depth: Array

    @property
    def same(self) -> Bools:
        """(M,) whether the point lies on the surface."""
        return np.abs(self.ratio - 1) < SAME_DEPTH

    @property
    def hiding(self) -> Bools:
        """(M,) whether it would hide the surface."""
        return self.ratio < 1 - BEFORE


def agreed(cameras: Sequence[Camera], maps: Sequence[DepthMap]) -> list[Surface]:
    """What the maps agree on: cells that another picture places alike and that hide no more surfaces than agree.

    One picture that agrees will do where nothing contradicts it: walls are often seen by two cameras alone, and their
    windows are alike in both directions at the wrong place in 1 of 60 cells. Patches of less than 25 cells are dropped.
    """
    surfaces = [
        Surface(camera, depths, depths.scores > LEAST_SCORE, np.zeros(len(depths.scores), np.intp))
        for camera, depths in zip(cameras, maps, strict=True)
    ]
    for number in range(ROUNDS):
        surfaces = [_judged(index, surfaces, number > 0) for index in range(len(surfaces))]
    return [replace(surface, known=_patches(surface.depths, surface.known)) for surface in surfaces]


def _judged(index: int, surfaces: Sequence[Surface], strict: bool) -> Surface:
    """The surface with the cells that the others confirm, and if ``strict`` do not contradict."""
    mine = surfaces[index]
    cells = np.flatnonzero(mine.known)
    alike, hiding = compared(index, surfaces, cells)
    known, support = np.zeros_like(mine.known), np.zeros_like(mine.support)
    known[cells] = (alike > 0) & (hiding < alike) if strict else alike > 0
    support[cells] = alike
    return replace(mine, known=known, support=support)


def compared(
    index: int, surfaces: Sequence[Surface], cells: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """How many other surfaces place cells (M,) of one alike (M,), and how many they would hide (M,)."""
    mine = surfaces[index]
    xyz = mine.points(cells)
    alike, hiding = np.zeros(len(cells), np.intp), np.zeros(len(cells), np.intp)
    for other in (*surfaces[:index], *surfaces[index + 1 :]):
        look = other.look(xyz)
        same = look.same
        back, _ = mine.camera.project(other.world(look.xy[same], look.inverse_depth[same]))
        same[same] = np.linalg.norm(back - 0.5 - mine.depths.grid.pixels[cells[same], :2], axis=1) < SAME_PLACE_PX
        alike += same
        hiding += look.hiding
    return alike, hiding


def _patches(depths: DepthMap, known: Bools) -> Bools:
    """(N,) the known cells that hang together with 25 or more by planes that continue each other."""
    numbers = np.arange(len(known)).reshape(depths.grid.shape)
    neighbours = (
        (numbers[:, :-1], numbers[:, 1:]),
        (numbers[:-1], numbers[1:]),
        (numbers[:-1, :-1], numbers[1:, 1:]),
        (numbers[1:, :-1], numbers[:-1, 1:]),
    )
    first, second = (np.concatenate([pair[end].ravel() for pair in neighbours]) for end in (0, 1))
    both = known[first] & known[second]
    first, second = first[both], second[both]
    joined = np.zeros(len(first), bool)
    for a, b in ((first, second), (second, first)):
        continued = np.einsum("nc,nc->n", depths.planes[a], depths.grid.pixels[b])
        joined |= np.abs(continued / depths.inverse_depth[b] - 1) < CONTINUED
    links = coo_array((joined[joined], (first[joined], second[joined])), shape=(len(known),) * 2)
    _, labels = connected_components(links, directed=False)
    return known & (np.bincount(labels)[labels] >= SMALLEST_PATCH)
