"""How alike two pictures are about a pixel, if the surface there is a given plane: correlation of small windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera

Floats = NDArray[np.float32]

HALF_WINDOW = 2
"""Samples on each side of the middle one."""
STEP_PX = 3
"""Between the samples of the smallest windows."""
LEVELS = 4
"""Sizes of windows, each twice as wide as the one before: smooth walls show something only in wide ones."""
TEXTURE = 2.5 / 255
"""Root mean square change of grey from sample to sample, in every direction, for which a window is wide enough."""
NOISE = 1.5 / 255
"""Spread of the grey values that is noise: windows of no more are like no other."""
LEAST_SEEN = 0.6
"""Of a window's samples."""
LONELY = np.float32(0.05)
"""What a correlation with one other picture alone counts less."""
NEVER = np.float32(-1.0)
BLOCK = 8192
"""Cells at a time: the arrays of a block stay in the cache, and OpenCV's remap takes no side beyond 32,767."""


@dataclass(frozen=True, eq=False)
class GreyView:
    """A picture to compare.

    Attributes:
        camera: pinhole of the picture.
        greys: (H, W) float32 about 0, NaN where nothing is known; sharp, and blurred for windows twice as wide each.
    """

    camera: Camera
    greys: tuple[Floats, ...]

    @staticmethod
    def of(camera: Camera, rgb: NDArray[np.uint8], seen: NDArray[np.bool_]) -> GreyView:
        """Of a picture (H, W, 3) that is seen (H, W) or not."""
        grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.float32) / np.float32(255) - np.float32(0.5)
        known = seen.astype(np.float32)
        greys = []
        for level in range(LEVELS):
            sigma = 0.4 * STEP_PX * 2**level if level else 0.5
            share = cv2.GaussianBlur(known, (0, 0), sigma)
            blurred = cv2.GaussianBlur(grey * known, (0, 0), sigma) / np.maximum(share, 1e-6)
            greys.append(np.where(seen, blurred, np.nan).astype(np.float32))
        return GreyView(camera, tuple(greys))


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of a picture, of which each has a plane.

    A plane is the 3-vector p of p . (x, y, 1) = 1 / depth, for the indices x, y (column, row) of pixels.

    Attributes:
        pixels: (N, 3) float32, (x, y, 1) of the cells' middles, row by row.
        shape: rows and columns of cells, of which N is the product.
        stride: pixels between neighbouring cells.
    """

    pixels: Floats
    shape: tuple[int, int]
    stride: int

    @staticmethod
    def over(width: int, height: int, stride: int) -> Grid:
        """Cells every ``stride`` pixels."""
        x, y = (np.arange((side - 1) % stride // 2, side, stride, dtype=np.float32) for side in (width, height))
        columns, rows = np.meshgrid(x, y)
        pixels = np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size, np.float32)], axis=1)
        return Grid(pixels, (len(y), len(x)), stride)

    @property
    def indices(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns (N,) of the pixels in the cells' middles."""
        return self.pixels[:, 1].astype(np.intp), self.pixels[:, 0].astype(np.intp)

    def cells_at(self, xy: NDArray[np.float64]) -> NDArray[np.intp]:
        """(M,) the cells that indices (M, 2) of pixels lie in, -1 outside all and for NaN."""
        columns, rows = (np.rint((xy[:, axis] - self.pixels[0, axis]) / self.stride) for axis in (0, 1))
        height, width = self.shape
        inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
        return np.where(inside, np.nan_to_num(rows) * width + np.nan_to_num(columns), -1).astype(np.intp)


def index_intrinsics(camera: Camera) -> NDArray[np.float64]:
    """K for indices of pixels: the first pixel's middle is (0, 0)."""
    k = camera.intrinsics.copy()
    k[:2, 2] -= 0.5
    return k


class Likeness:
    """Compares one picture's windows with those of others."""

    def __init__(self, view: GreyView, sources: Sequence[GreyView], grid: Grid) -> None:
        """``sources`` are the pictures to compare with."""
        side = np.arange(-HALF_WINDOW, HALF_WINDOW + 1, dtype=np.float32) * STEP_PX
        self._across, self._down = (axis.reshape(-1, 1) for axis in np.meshgrid(side, side))
        self._pixels = grid.pixels
        self._sources = [(source.greys, _Transfer.between(view.camera, source.camera)) for source in sources]
        self._levels = _levels(view, grid)
        self._windows = np.empty((len(self._across), len(grid.pixels)), np.float32)
        for level in range(LEVELS):
            cells = np.flatnonzero(self._levels == level)
            x = grid.pixels[cells, 0] + self._across * np.float32(2**level)
            y = grid.pixels[cells, 1] + self._down * np.float32(2**level)
            self._windows[:, cells] = _sampled(view.greys[level], x, y)
        count, spread = _known(self._windows)
        middle = np.isfinite(self._windows[len(self._across) // 2])
        self.usable: NDArray[np.bool_] = middle & (count >= LEAST_SEEN * len(self._across)) & (spread > NOISE)
        """(N,) cells that are seen, with enough of their window, which shows more than noise."""

    def scores(self, cells: NDArray[np.intp], planes: Floats) -> Floats:
        """(n,) how well cells (n,) with planes (n, 3) fit, at most 1; -1 where no other picture sees them.

        The mean of the two best correlations, so that what one of the others does not see for something before it
        counts as well; a single one counts for a little less.
        """
        out = np.empty(len(cells), np.float32)
        for level in range(LEVELS):
            rows = np.flatnonzero(self._levels[cells] == level)
            for begin in range(0, len(rows), BLOCK):
                block = rows[begin : begin + BLOCK]
                out[block] = self._block(level, cells[block], planes[block])
        return out

    def _block(self, level: int, cells: NDArray[np.intp], planes: Floats) -> Floats:
        best = np.full((2, len(cells)), NEVER, np.float32)
        windows, pixels = np.ascontiguousarray(self._windows[:, cells]), self._pixels[cells]
        across, down = self._across * np.float32(2**level), self._down * np.float32(2**level)
        for greys, transfer in self._sources:
            rows = np.flatnonzero(transfer.inside(pixels, planes, greys[level].shape))
            x, y = transfer.places(pixels[rows], planes[rows], across, down)
            found = np.full(len(cells), NEVER, np.float32)
            found[rows] = _correlations(windows[:, rows], _sampled(greys[level], x, y))
            best[1] = np.maximum(best[1], np.minimum(best[0], found))
            best[0] = np.maximum(best[0], found)
        alone = best[1] <= NEVER
        return np.where(alone, best[0] - LONELY * (best[0] > NEVER), best.mean(axis=0))


@dataclass(frozen=True, eq=False)
class _Transfer:
    """From one picture into another: indices (x, y, 1) of inverse depth w lie at turn @ (x, y, 1) + w shift."""

    turn: Floats
    shift: Floats

    @staticmethod
    def between(view: Camera, other: Camera) -> _Transfer:
        rotation = other.rotation @ view.rotation.T
        k = index_intrinsics(other)
        turn = k @ rotation @ np.linalg.inv(index_intrinsics(view))
        shift = k @ (other.translation - rotation @ view.translation)
        return _Transfer(turn.astype(np.float32), shift.astype(np.float32))

    def inside(self, pixels: Floats, planes: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """(n,) whether cells' middles (n, 3) with planes (n, 3) lie in the other picture, of H x W pixels."""
        x, y, depth = self._middles(pixels, planes)
        height, width = shape
        return (depth > 0) & (x >= 0) & (y >= 0) & (x <= (width - 1) * depth) & (y <= (height - 1) * depth)

    def places(self, pixels: Floats, planes: Floats, across: Floats, down: Floats) -> tuple[Floats, Floats]:
        """x and y (o, n) of the samples (o, 1) across and down of cells (n, 3) with planes (n, 3); NaN behind."""
        middle = self._middles(pixels, planes)
        by_x, by_y = (self.turn[:, axis, None] + self.shift[:, None] * planes[:, axis] for axis in (0, 1))
        x, y, depth = (middle[row] + across * by_x[row] + down * by_y[row] for row in range(3))
        with np.errstate(divide="ignore", invalid="ignore"):
            nearness = np.where(depth > 1e-6, 1 / depth, np.float32(np.nan))
        return x * nearness, y * nearness

    def _middles(self, pixels: Floats, planes: Floats) -> Floats:
        """(3, n) homogeneous indices of the cells' middles; summed by hand, since BLAS would start threads for it."""
        inverse = np.einsum("nc,nc->n", planes, pixels)
        turned = self.turn[:, :1] * pixels[:, 0] + self.turn[:, 1:2] * pixels[:, 1] + self.turn[:, 2:]
        return np.asarray(turned + self.shift[:, None] * inverse, np.float32)


def _levels(view: GreyView, grid: Grid) -> NDArray[np.int8]:
    """(N,) the size of window for each cell: the smallest that shows texture in every direction."""
    level = np.full(len(grid.pixels), LEVELS - 1, np.int8)
    for index in reversed(range(LEVELS)):
        grey = np.nan_to_num(view.greys[index])
        step = STEP_PX * 2**index
        side = 2 * HALF_WINDOW * step + 1
        gx, gy = (cv2.filter2D(grey, -1, kernel) for kernel in _differences(step))
        xx, yy, xy = (cv2.boxFilter(a * b, -1, (side, side)) for a, b in ((gx, gx), (gy, gy), (gx, gy)))
        # The smaller eigenvalue of the windows' structure tensor.
        least = (xx + yy) / 2 - np.sqrt(np.maximum(((xx - yy) / 2) ** 2 + xy**2, 0))
        level[least[grid.indices] > TEXTURE**2] = index
    return level


def _differences(step: int) -> tuple[Floats, Floats]:
    """Kernels of the change of grey over a step, across and down."""
    half = (step + 1) // 2
    kernel = np.zeros((1, 2 * half + 1), np.float32)
    kernel[0, 0], kernel[0, -1] = -step / (2 * half), step / (2 * half)
    return kernel, np.ascontiguousarray(kernel.T)


def _correlations(first: Floats, second: Floats) -> Floats:
    """(n,) correlations of windows (o, n) over the samples that are known in both; -1 where these are too few."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    both, aa, bb = (np.einsum("on,on->n", u, v) / len(first) for u, v in ((a, b), (a, a), (b, b)))
    found = both / np.sqrt((aa + NOISE**2) * (bb + NOISE**2))
    parts = np.flatnonzero(np.isnan(found))
    if len(parts):
        found[parts] = _partly_known(first[:, parts], second[:, parts])
    return np.asarray(found, np.float32)


def _partly_known(first: Floats, second: Floats) -> Floats:
    """As _correlations, where some samples are NaN."""
    known = np.isfinite(first) & np.isfinite(second)
    count = known.sum(axis=0)
    out = np.full(len(count), NEVER, np.float32)
    rich = np.flatnonzero(count >= LEAST_SEEN * len(first))
    known = known[:, rich]
    weight = known / count[rich].astype(np.float32)
    a, b = np.where(known, first[:, rich], 0), np.where(known, second[:, rich], 0)
    a -= (weight * a).sum(axis=0)
    b -= (weight * b).sum(axis=0)
    both, aa, bb = ((weight * u * v).sum(axis=0) for u, v in ((a, b), (a, a), (b, b)))
    out[rich] = both / np.sqrt((aa + NOISE**2) * (bb + NOISE**2))
    return out


def _known(windows: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Count and spread (n,) of the known samples of windows (o, n)."""
    known = np.isfinite(windows)
    count = known.sum(axis=0)
    share = np.maximum(count, 1)
    mean = np.where(known, windows, 0).sum(axis=0) / share
    return count, np.sqrt((np.where(known, windows - mean, 0) ** 2).sum(axis=0) / share)


def _sampled(grey: Floats, x: Floats, y: Floats) -> Floats:
    """Values at indices x, y, NaN outside and where these are NaN."""
    if not x.size:
        return np.empty(x.shape, np.float32)
    height, width = grey.shape
    # Far places are brought near, where OpenCV's numbers suffice; NaN goes outside.
    x, y = np.fmax(np.fmin(x, width + 9), -9), np.fmax(np.fmin(y, height + 9), -9)
    nothing = float("nan")
    return np.asarray(
        cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=nothing), np.float32
    )
