"""Sample points on surfaces, evenly spread over the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.recording.stereo.fusion import Surface

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

SAME_SURFACE = 0.05
"""A sample of one image also counts as a sample of another image's surface if the relative difference between its depth
and the surface's depth is below this value."""
BISECTION_STEPS = 8
MIN_SIDE_PX = 1.0
"""Minimum side length, in pixels, of the squares into which :func:`sample_surfaces` divides the images."""
EDGE_TOLERANCE = 0.05
"""A cell is at a depth edge if, along one of the image axes, its plane predicts the inverse depth of both neighbours
with a relative error above this value."""
MAX_PARTS = 2
"""Maximum number of parts into which a square is divided along each axis. More parts would close all gaps between
points on steep surfaces. But points are drawn as discs, and the points of a floor would then be so dense that each disc
hides the lower half of the disc behind it. This would shift the floor's texture upwards in the image by half the size
of a point."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one image's surface.

    Attributes:
        xy: (M, 2) pixel indices.
        xyz: (M, 3) world points.
        support: (M,) number of other images that confirm the depth of the sample; 0 if the depth is extrapolated.
    """

    xy: Array
    xyz: Array
    support: NDArray[np.intp]

    def select(self, rows: Bools) -> Samples:
        """Select samples with the bool mask ``rows`` (M,)."""
        return Samples(self.xy[rows], self.xyz[rows], self.support[rows])


def sample_surfaces(surfaces: Sequence[Surface], seen: Sequence[Bools], points: int) -> list[Samples]:
    """Sample all surfaces, with at most ``points`` samples in total.

    Each image is tiled with squares, all of the smallest size that gives at most ``points`` samples. A square is
    divided into parts if the image's camera sees its surface at a grazing angle, because cameras that see the surface
    less obliquely would otherwise see gaps between the samples.

    The centre of each part is sampled if ``seen`` (H, W) is true there and the part has no sample yet. An earlier
    sample, from any image, counts if it projects into the part and its depth agrees with the surface's depth. Near
    objects therefore get more points than far ones, but the number of points does not depend on how many images show a
    surface. All images are sampled first where other images confirm the depth, and then where no other image does.

    Returns:
        the samples of each image.
    """
    sloped = [_SlopedSurface(surface, _slopes(surface)) for surface in surfaces]
    samples = _sample_at(sloped, seen, MIN_SIDE_PX, points)
    if _count(samples) <= points:
        return samples
    pixels = sum(surface.camera.width * surface.camera.height for surface in surfaces)
    low, high = np.log(MIN_SIDE_PX), np.log(max(np.sqrt(pixels / points), 2 * MIN_SIDE_PX))
    while _count(samples := _sample_at(sloped, seen, float(np.exp(high)), points)) > points:
        low, high = high, high + np.log(2)
    for _ in range(BISECTION_STEPS):
        middle = (low + high) / 2
        trial = _sample_at(sloped, seen, float(np.exp(middle)), points)
        if _count(trial) > points:
            low = middle
        else:
            high, samples = middle, trial
    return samples


def _count(samples: Sequence[Samples]) -> int:
    return sum(len(each.xyz) for each in samples)


@dataclass(frozen=True, eq=False)
class _SlopedSurface:
    """An image's surface with the slopes (N, 2) of its cells, computed by :func:`_slopes`."""

    surface: Surface
    slopes: Array


def _sample_at(sloped: Sequence[_SlopedSurface], seen: Sequence[Bools], side: float, limit: int) -> list[Samples]:
    """Sample all surfaces with squares of side ``side`` pixels. Sampling ends early once there are more than ``limit``
    samples."""
    tilings = [_Tiling.of(each, side) for each in sloped]
    candidates = [_part_samples(*each) for each in zip(sloped, seen, tilings, strict=True)]
    taken = [np.zeros(len(each.xyz), bool) for each in candidates]
    for confirmed in (True, False):
        for index, (each, tiling, own) in enumerate(zip(sloped, tilings, candidates, strict=True)):
            covered = np.zeros(tiling.count, bool)
            for other, rows in zip(candidates, taken, strict=True):
                projection = each.surface.project(other.xyz[rows])
                covered[tiling.parts_at(projection.xy[np.abs(projection.ratio - 1) < SAME_SURFACE])] = True
            free = ~covered[tiling.parts_at(own.xy)]
            taken[index] |= free & ((own.support > 0) == confirmed)
            if sum(int(rows.sum()) for rows in taken) > limit:
                return [samples.select(rows) for samples, rows in zip(candidates, taken, strict=True)]
    return [samples.select(rows) for samples, rows in zip(candidates, taken, strict=True)]


def _part_samples(sloped: _SlopedSurface, seen: Bools, tiling: _Tiling) -> Samples:
    """Sample the surface at the centre of each part of a square. Parts are skipped if their centre lies outside the
    image, in an unknown cell, or at a pixel where the mask ``seen`` is false."""
    surface = sloped.surface
    xy = tiling.centres()
    last = (surface.camera.width - 1, surface.camera.height - 1)
    cells = surface.depths.grid.cells_at(xy)
    valid = (cells >= 0) & surface.known[cells]
    at_column, at_row = np.clip(np.rint(xy), 0, last).astype(np.intp).T
    valid &= (xy > -0.5).all(axis=1) & (xy < np.add(last, 0.5)).all(axis=1)
    valid &= seen[at_row, at_column]
    xy, cells = xy[valid], cells[valid]
    offset = xy - surface.depths.grid.pixels[cells, :2]
    inverse = surface.depths.inverse_depth[cells] * (1 + (sloped.slopes[cells] * offset).sum(axis=1))
    return Samples(xy, surface.world(xy, inverse), surface.support[cells])


@dataclass(frozen=True)
class _Squares:
    """An image tiled with squares. Every second row of squares is shifted left by half a square, to make the density
    more even.

    Attributes:
        side: side length of a square in pixels.
        width: width of the image in pixels.
        height: height of the image in pixels.
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
        """Compute the upper left corners (N, 2) and the lower right corners (N, 2) of the squares in pixels, clipped to
        the image."""
        column, row = (axis.ravel() for axis in np.meshgrid(np.arange(self.columns), np.arange(self.rows)))
        begins = np.stack([column * self.side - self._shift(row), row * self.side], axis=1)
        size = (self.width, self.height)
        return np.clip(begins, 0, size), np.clip(begins + self.side, 0, size)

    def squares_at(self, xy: Array) -> NDArray[np.intp]:
        """Return the indices (M,) of the squares in which the pixels ``xy`` (M, 2) lie. For a pixel outside the image,
        return the index of the nearest square."""
        row = np.clip((xy[:, 1] + 0.5) / self.side, 0, self.rows - 1).astype(np.intp)
        column = np.clip((xy[:, 0] + 0.5 + self._shift(row)) / self.side, 0, self.columns - 1).astype(np.intp)
        return np.asarray(row * self.columns + column, np.intp)

    def _shift(self, row: NDArray[np.intp]) -> Array:
        return np.asarray(row % 2 * (self.side / 2))


@dataclass(frozen=True, eq=False)
class _Tiling:
    """The squares of an image and their parts. A square is divided into several parts if the camera sees the surface in
    it at a grazing angle; otherwise, the square has one part.

    Attributes:
        squares: the tiling with N squares.
        begins: (N, 2) upper left corners of the squares in pixels.
        ends: (N, 2) lower right corners of the squares in pixels.
        parts: (N, 2) number of parts of each square along x and y.
        first: (N,) index of each square's first part.
        count: total number of parts of all squares.
    """

    squares: _Squares
    begins: Array
    ends: Array
    parts: NDArray[np.intp]
    first: NDArray[np.intp]
    count: int

    @staticmethod
    def of(sloped: _SlopedSurface, side: float) -> _Tiling:
        """Tile an image with squares of side ``side`` pixels."""
        squares = _Squares(side, sloped.surface.camera.width, sloped.surface.camera.height)
        begins, ends = squares.corners()
        parts = _part_counts(sloped, (begins + ends) / 2 - 0.5)
        counts = parts.prod(axis=1)
        return _Tiling(squares, begins, ends, parts, np.cumsum(counts) - counts, int(counts.sum()))

    def centres(self) -> Array:
        """Compute the pixel indices (count, 2) of the parts' centres."""
        square = np.repeat(np.arange(len(self.parts)), self.parts.prod(axis=1))
        number = np.arange(self.count) - self.first[square]
        position = np.stack([number % self.parts[square, 0], number // self.parts[square, 0]], axis=1) + 0.5
        size = self.ends[square] - self.begins[square]
        return np.asarray(self.begins[square] + size * position / self.parts[square] - 0.5)

    def parts_at(self, xy: Array) -> NDArray[np.intp]:
        """Return the indices (M,) of the parts that contain pixel indices (M, 2)."""
        square = self.squares.squares_at(xy)
        size = np.maximum(self.ends[square] - self.begins[square], np.finfo(float).tiny)
        position = (xy + 0.5 - self.begins[square]) / size * self.parts[square]
        across, down = np.clip(position, 0, self.parts[square] - 1).astype(np.intp).T
        return np.asarray(self.first[square] + down * self.parts[square, 0] + across, np.intp)


def _part_counts(sloped: _SlopedSurface, xy: Array) -> NDArray[np.intp]:
    """Compute the number of parts (M, 2) along x and y, for squares centred on pixel indices (M, 2).

    The number of parts grows with the square root of the surface's slope.
    """
    surface = sloped.surface
    cells = np.maximum(surface.depths.grid.cells_at(xy), 0)
    slopes = surface.camera.intrinsics[0, 0] * sloped.slopes[cells]
    parts = np.minimum(np.sqrt(np.hypot(1, slopes)), MAX_PARTS)
    return np.where(surface.known[cells][:, None], np.rint(parts), 1).astype(np.intp)


def _slopes(surface: Surface) -> Array:
    """Compute the relative change (N, 2) of the inverse depth per pixel along x and y. It is 0 at depth edges."""
    grid = surface.depths.grid
    inverse = np.maximum(surface.depths.inverse_depth, np.finfo(np.float32).tiny).astype(np.float64)
    slopes = surface.depths.planes[:, :2] / inverse[:, None]
    edge = np.zeros(grid.shape, bool)
    for axis, slope in ((1, slopes[:, 0]), (0, slopes[:, 1])):
        edge |= (
            _extrapolation_error(inverse.reshape(grid.shape), slope.reshape(grid.shape) * grid.stride, axis)
            > EDGE_TOLERANCE
        )
    return np.where(edge.ravel()[:, None], 0.0, slopes)


def _extrapolation_error(inverse: Array, change: Array, axis: int) -> Array:
    """Extrapolate each cell's inverse depth linearly to its two neighbours along ``axis``, and return the smaller of
    the two errors (R, C), relative to the cell's inverse depth.

    Args:
        inverse: (R, C) inverse depths.
        change: (R, C) relative change of the inverse depth from a cell to the next one, by which it is extrapolated.
        axis: 0 for the neighbours above and below, 1 for the neighbours to the left and right.
    """
    smallest = np.full_like(inverse, np.inf)
    for step in (-1, 1):
        error = np.abs(np.roll(inverse, -step, axis) / inverse - 1 - step * change)
        outer: list[slice | int] = [slice(None), slice(None)]
        outer[axis] = -1 if step == 1 else 0
        error[tuple(outer)] = np.inf
        smallest = np.minimum(smallest, error)
    return smallest if inverse.shape[axis] > 1 else np.zeros_like(inverse)
