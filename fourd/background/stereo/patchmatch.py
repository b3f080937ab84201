"""A depth map of one picture by PatchMatch: planes handed on from cell to cell where they make the windows alike.

Bleyer, Rhemann, Rother, PatchMatch Stereo, BMVC 2011; all cells at once, as Galliani, Lasinger, Schindler, ICCV 2015.
Planes, not depths: floors are seen at grazing angles, where windows of one depth are like no other picture's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.background.stereo.patches import NEVER, Floats, GreyView, Grid, Likeness, index_intrinsics

Array = NDArray[np.float64]

ROUNDS = 4
RANDOM_PLANES = 6
STEEPEST = float(np.cos(np.radians(88)))
"""Cosine of the angle between a plane's normal and the ray; a floor at eye level's depth is seen at 3 degrees."""
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (0, 4), (0, -4), (4, 0), (-4, 0))
SAME_DEPTH = 1e-3


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Planes of a picture's cells.

    Attributes:
        grid: the cells.
        planes: (N, 3) float32, see Grid.
        scores: (N,) float32, how alike the windows are, at most 1; NEVER where nothing is known.
    """

    grid: Grid
    planes: Floats
    scores: Floats

    @property
    def inverse_depth(self) -> Floats:
        """(N,) one by the depth in the middle of the cells."""
        return np.einsum("nc,nc->n", self.planes, self.grid.pixels)

    @staticmethod
    def through(grid: Grid, inverse_depth: Array, scores: Floats) -> DepthMap:
        """A map whose planes go through inverse depths (N,), as steep as these change from cell to cell."""
        values = inverse_depth.reshape(grid.shape)
        down, across = (_slope(values, axis) / grid.stride for axis in (0, 1))
        middle = inverse_depth - across * grid.pixels[:, 0] - down * grid.pixels[:, 1]
        return DepthMap(grid, np.stack([across, down, middle], axis=1).astype(np.float32), scores)

    @staticmethod
    def unknown(grid: Grid) -> DepthMap:
        """A map that knows nothing."""
        return DepthMap(grid, np.zeros_like(grid.pixels), np.full(len(grid.pixels), NEVER, np.float32))


def _slope(values: Array, axis: int) -> Array:
    """(N,) change from cell to cell along an axis of values (R, C)."""
    return np.gradient(values, axis=axis).ravel() if values.shape[axis] > 1 else np.zeros(values.size)


def depth_map(
    view: GreyView,
    sources: Sequence[GreyView],
    grid: Grid,
    guesses: Sequence[Floats],
    nearest: float,
    farthest: float,
    seed: int,
) -> DepthMap:
    """Find the planes of a picture's cells.

    Args:
        sources: pictures to compare with.
        guesses: (N, 3) planes to try, each for all cells; rows with NaN are none.
        nearest, farthest: depths to look between, world units.
        seed: of the random guesses.
    """
    rng = np.random.default_rng(seed)
    search = _Search(view, Likeness(view, sources, grid), grid, 1 / farthest, 1 / nearest)
    for planes in guesses:
        search.try_planes(planes)
    for _ in range(RANDOM_PLANES):
        search.try_planes(search.random_planes(rng))
    for turn in range(ROUNDS):
        for down, across in NEIGHBOURS:
            search.hand_on(down, across)
        for zoom in (0.5, 0.25, 0.1):
            search.try_planes(search.varied(rng, zoom * 0.5**turn))
    return DepthMap(grid, search.planes, search.scores)


class _Search:
    """The best planes so far."""

    def __init__(self, view: GreyView, likeness: Likeness, grid: Grid, least: float, most: float) -> None:
        self._likeness, self._grid = likeness, grid
        self._range = np.float32(least), np.float32(most)
        self._k = index_intrinsics(view.camera)
        rays = grid.pixels @ np.linalg.inv(self._k).T
        self._rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
        self.planes = np.zeros_like(grid.pixels)
        self.scores = np.full(len(grid.pixels), NEVER, np.float32)

    def try_planes(self, planes: Floats, where: NDArray[np.bool_] | None = None) -> None:
        """Take each cell's plane of (N, 3) where it fits better than the one it has."""
        usable = self._likeness.usable & self._allowed(planes)
        cells = np.flatnonzero(usable if where is None else usable & where)
        scores = self._likeness.scores(cells, planes[cells])
        better = scores > self.scores[cells]
        self.scores[cells[better]] = scores[better]
        self.planes[cells[better]] = planes[cells[better]]

    def hand_on(self, down: int, across: int) -> None:
        """Try the plane of the cell so many cells away, where that one fits better and is another."""
        rows, columns = self._grid.shape
        numbers = np.arange(rows * columns).reshape(rows, columns)
        i, j = np.clip(np.arange(rows) + down, 0, rows - 1), np.clip(np.arange(columns) + across, 0, columns - 1)
        other = numbers[np.ix_(i, j)].ravel()
        planes = self.planes[other]
        there, here = self._inverse(planes), self._inverse(self.planes)
        self.try_planes(planes, (self.scores[other] > self.scores) & (np.abs(there - here) > SAME_DEPTH * here))

    def random_planes(self, rng: np.random.Generator) -> Floats:
        """(N, 3) planes of any inverse depth in the range that face the camera."""
        count = len(self.planes)
        return self._through(rng.uniform(*self._range, count), self._facing(rng, count))

    def varied(self, rng: np.random.Generator, share: float) -> Floats:
        """(N, 3) the planes, moved by up to a share of their depth and turned by about as much."""
        inverse = self._inverse(self.planes)
        normals = self.planes @ self._k
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        normals = normals + share * rng.normal(size=normals.shape)
        return self._through(inverse * (1 + share * rng.uniform(-0.2, 0.2, len(inverse))), normals)

    def _through(self, inverse: NDArray[np.floating], normals: NDArray[np.floating]) -> Floats:
        """Planes with normals (N, 3) in the camera's frame, of the given inverse depth in the cells' middles."""
        planes = normals @ np.linalg.inv(self._k)
        now = np.einsum("nc,nc->n", planes, self._grid.pixels)
        with np.errstate(divide="ignore", invalid="ignore"):
            return (planes * (inverse / now)[:, None]).astype(np.float32)

    def _facing(self, rng: np.random.Generator, count: int) -> Floats:
        """(N, 3) directions within 70 degrees or so of the rays."""
        sideways = rng.normal(size=(count, 3))
        return (
            self._rays + sideways / np.linalg.norm(sideways, axis=1, keepdims=True) * rng.uniform(0, 0.95, (count, 1))
        ).astype(np.float32)

    def _inverse(self, planes: Floats) -> Floats:
        return np.einsum("nc,nc->n", planes, self._grid.pixels)

    def _allowed(self, planes: Floats) -> NDArray[np.bool_]:
        """Which planes lie within the range and are not seen edge on; NaN is not allowed."""
        inverse = self._inverse(planes)
        normals = planes @ self._k.astype(np.float32)
        cosine = np.einsum("nc,nc->n", normals, self._rays)
        facing = cosine > STEEPEST * np.linalg.norm(normals, axis=1)
        return (inverse >= self._range[0]) & (inverse <= self._range[1]) & facing
