"""Estimate the depth map of one image by PatchMatch, which propagates planes between neighbouring cells.

The method is PatchMatch Stereo (Bleyer, Rhemann, Rother, BMVC 2011). All cells are updated in parallel, as in Galliani,
Lasinger, Schindler, ICCV 2015. Cells store planes instead of depths, because fronto-parallel windows do not match on
surfaces at grazing angles, such as floors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.recording.stereo.patches import UNKNOWN_SCORE, Floats, GreyView, Grid, PatchSimilarity, index_intrinsics

Array = NDArray[np.float64]

ITERATIONS = 4
RANDOM_PLANES = 6
MIN_INCIDENCE_COSINE = float(np.cos(np.radians(88)))
"""Minimum cosine of the angle between a plane's normal and the ray. The limit of 88 degrees permits distant floors,
where the angle is about 87 degrees."""
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (0, 4), (0, -4), (4, 0), (-4, 0))
"""Offsets (rows, columns) from a cell to the neighbours whose planes are propagated to it."""
SAME_DEPTH = 1e-3
"""A neighbour's plane is tried only if the inverse depth that it gives at the cell differs from the cell's current
inverse depth by more than this fraction."""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """One plane per cell of an image.

    Attributes:
        grid: the grid of N cells.
        planes: (N, 3) float32 planes, stored as described in :class:`Grid`.
        scores: (N,) float32 photometric similarity of at most 1, or UNKNOWN_SCORE if the plane is unknown.
    """

    grid: Grid
    planes: Floats
    scores: Floats

    @property
    def inverse_depth(self) -> Floats:
        """Inverse depths (N,) at the cell centres."""
        return np.einsum("nc,nc->n", self.planes, self.grid.pixels)

    @staticmethod
    def from_inverse_depth(grid: Grid, inverse_depth: Array, scores: Floats) -> DepthMap:
        """Create a depth map from inverse depths (N,). The slopes of the planes are finite differences of inverse depth
        between cells."""
        values = inverse_depth.reshape(grid.shape)
        down, across = (_slope(values, axis) / grid.stride for axis in (0, 1))
        offset = inverse_depth - across * grid.pixels[:, 0] - down * grid.pixels[:, 1]
        return DepthMap(grid, np.stack([across, down, offset], axis=1).astype(np.float32), scores)

    @staticmethod
    def unknown(grid: Grid) -> DepthMap:
        """Create a depth map in which all cells are unknown."""
        return DepthMap(grid, np.zeros_like(grid.pixels), np.full(len(grid.pixels), UNKNOWN_SCORE, np.float32))


def _slope(values: Array, axis: int) -> Array:
    """Compute finite differences (N,) of values (R, C) along an axis, per cell."""
    return np.gradient(values, axis=axis).ravel() if values.shape[axis] > 1 else np.zeros(values.size)


def estimate_depth_map(
    view: GreyView,
    sources: Sequence[GreyView],
    grid: Grid,
    hypotheses: Sequence[Floats],
    nearest: float,
    farthest: float,
    seed: int,
) -> DepthMap:
    """Estimate the plane of each cell of an image.

    Args:
        view: the image for which planes are estimated.
        sources: images that are compared with ``view``.
        grid: the grid of N cells.
        hypotheses: sets of initial planes; each set is (N, 3) with one plane per cell. Planes with NaN are skipped.
        nearest: lower end of the depth range in world units.
        farthest: upper end of the depth range in world units.
        seed: random seed.
    """
    rng = np.random.default_rng(seed)
    search = _PlaneSearch(view, PatchSimilarity(view, sources, grid), grid, 1 / farthest, 1 / nearest)
    for planes in hypotheses:
        search.try_planes(planes)
    for _ in range(RANDOM_PLANES):
        search.try_planes(search.random_planes(rng))
    for iteration in range(ITERATIONS):
        for down, across in NEIGHBOURS:
            search.propagate(down, across)
        for scale in (0.5, 0.25, 0.1):
            search.try_planes(search.perturbed_planes(rng, scale * 0.5**iteration))
    return DepthMap(grid, search.planes, search.scores)


class _PlaneSearch:
    """Search for the plane with the highest score in each cell. Stores the best planes and their scores."""

    def __init__(
        self, view: GreyView, similarity: PatchSimilarity, grid: Grid, min_inverse: float, max_inverse: float
    ) -> None:
        self._similarity, self._grid = similarity, grid
        self._range = np.float32(min_inverse), np.float32(max_inverse)
        self._k = index_intrinsics(view.camera)
        rays = grid.pixels @ np.linalg.inv(self._k).T
        self._rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
        self.planes = np.zeros_like(grid.pixels)
        self.scores = np.full(len(grid.pixels), UNKNOWN_SCORE, np.float32)

    def try_planes(self, planes: Floats, where: NDArray[np.bool_] | None = None) -> None:
        """Replace a cell's plane by the cell's row of ``planes`` (N, 3) if the new plane has a higher score.

        If ``where`` (N,) is given, only the selected cells are updated.
        """
        usable = self._similarity.usable & self._is_valid(planes)
        cells = np.flatnonzero(usable if where is None else usable & where)
        scores = self._similarity.scores(cells, planes[cells])
        better = scores > self.scores[cells]
        self.scores[cells[better]] = scores[better]
        self.planes[cells[better]] = planes[cells[better]]

    def propagate(self, down: int, across: int) -> None:
        """For each cell, try the plane of the neighbour at the given offset if the neighbour has a higher score and its
        plane gives a different depth."""
        rows, columns = self._grid.shape
        numbers = np.arange(rows * columns).reshape(rows, columns)
        i, j = np.clip(np.arange(rows) + down, 0, rows - 1), np.clip(np.arange(columns) + across, 0, columns - 1)
        other = numbers[np.ix_(i, j)].ravel()
        planes = self.planes[other]
        theirs, ours = self._inverse_depth(planes), self._inverse_depth(self.planes)
        self.try_planes(planes, (self.scores[other] > self.scores) & (np.abs(theirs - ours) > SAME_DEPTH * ours))

    def random_planes(self, rng: np.random.Generator) -> Floats:
        """Draw random planes (N, 3) that face the camera, with inverse depths distributed uniformly over the depth
        range."""
        count = len(self.planes)
        return self._planes_at(rng.uniform(*self._range, count), self._random_normals(rng, count))

    def perturbed_planes(self, rng: np.random.Generator, share: float) -> Floats:
        """Return the current planes (N, 3) with random changes of inverse depth and normal, which are proportional to
        ``share``."""
        inverse = self._inverse_depth(self.planes)
        normals = self.planes @ self._k
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        normals = normals + share * rng.normal(size=normals.shape)
        return self._planes_at(inverse * (1 + share * rng.uniform(-0.2, 0.2, len(inverse))), normals)

    def _planes_at(self, inverse: NDArray[np.floating], normals: NDArray[np.floating]) -> Floats:
        """Create planes with normals (N, 3) in camera coordinates and the given inverse depths (N,) at the cell
        centres."""
        planes = normals @ np.linalg.inv(self._k)
        unscaled = np.einsum("nc,nc->n", planes, self._grid.pixels)
        with np.errstate(divide="ignore", invalid="ignore"):
            return (planes * (inverse / unscaled)[:, None]).astype(np.float32)

    def _random_normals(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw random directions (N, 3) within about 70 degrees of the cells' rays."""
        sideways = rng.normal(size=(count, 3))
        return (
            self._rays + sideways / np.linalg.norm(sideways, axis=1, keepdims=True) * rng.uniform(0, 0.95, (count, 1))
        ).astype(np.float32)

    def _inverse_depth(self, planes: Floats) -> Floats:
        return np.einsum("nc,nc->n", planes, self._grid.pixels)

    def _is_valid(self, planes: Floats) -> NDArray[np.bool_]:
        """Return an (N,) bool mask of the planes that are in the depth range and are not seen edge-on. It is false for
        NaN planes."""
        inverse = self._inverse_depth(planes)
        normals = planes @ self._k.astype(np.float32)
        cosine = np.einsum("nc,nc->n", normals, self._rays)
        facing = cosine > MIN_INCIDENCE_COSINE * np.linalg.norm(normals, axis=1)
        return (inverse >= self._range[0]) & (inverse <= self._range[1]) & facing
