"""Photometric similarity of images under plane hypotheses. A hypothesis maps a small window of one image to another
image. The similarity is the normalised cross-correlation of the two windows.

A cell is one sample of a depth map. The cells form a regular grid over the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

Floats = NDArray[np.float32]

HALF_WINDOW = 2
"""Number of samples on each side of the window's centre."""
STEP_PX = 3
"""Distance in pixels between samples of the smallest window."""
LEVELS = 4
"""Number of window sizes, each twice as wide as the previous one. Large windows are needed on smooth walls, which have
texture only at large scales."""
MIN_TEXTURE = 2.5 / 255
"""Minimum root mean square difference between the grey values, in [0, 1], of neighbouring samples in a window. Each
cell uses the smallest window size for which this difference exceeds the minimum in every direction."""
NOISE_STD = 1.5 / 255
"""Standard deviation of image noise, for grey values in [0, 1]. Windows with less contrast cannot be matched."""
MIN_VISIBLE = 0.6
"""Minimum fraction of a window's samples that lie outside holes, which are areas of a clean plate that do not show the
background."""
SINGLE_SOURCE_PENALTY = np.float32(0.05)
"""Value that is subtracted from the correlation if the cell is visible in only one source image."""
UNKNOWN_SCORE = np.float32(-1.0)
"""Score of a plane that cannot be compared with any source image."""
BLOCK = 8192
"""Number of cells that are processed together. It is so small that a block's arrays fit into the processor's cache, and
that their side lengths stay below 32,767, the limit of OpenCV's remap."""


@dataclass(frozen=True, eq=False)
class GreyView:
    """A grey image at several levels of blur.

    Attributes:
        camera: pinhole camera of the image.
        greys: (H, W) float32 grey values in [-0.5, 0.5], one array per window size, with NaN in holes. The first array
            is almost sharp, and the blur of the others is proportional to the window size.
    """

    camera: Camera
    greys: tuple[Floats, ...]

    @staticmethod
    def from_rgb(camera: Camera, rgb: NDArray[np.uint8], seen: NDArray[np.bool_]) -> GreyView:
        """Convert an RGB image (H, W, 3), whose valid pixels are ``seen`` (H, W), to blurred grey images."""
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
    """A regular grid of cells over an image. A depth map has one plane per cell.

    A plane is stored as a 3-vector p with p . (x, y, 1) = 1 / depth for pixel indices x (column) and y (row).

    Attributes:
        pixels: (N, 3) float32 homogeneous pixel indices (x, y, 1) of the cell centres in row-major order.
        shape: numbers of rows and columns; N is rows * columns.
        stride: distance between neighbouring cells in pixels.
    """

    pixels: Floats
    shape: tuple[int, int]
    stride: int

    @staticmethod
    def covering(width: int, height: int, stride: int) -> Grid:
        """Create a grid over an image with one cell every ``stride`` pixels."""
        x, y = (np.arange((side - 1) % stride // 2, side, stride, dtype=np.float32) for side in (width, height))
        columns, rows = np.meshgrid(x, y)
        pixels = np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size, np.float32)], axis=1)
        return Grid(pixels, (len(y), len(x)), stride)

    @property
    def indices(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows (N,) and columns (N,) of the pixels at the cell centres."""
        return self.pixels[:, 1].astype(np.intp), self.pixels[:, 0].astype(np.intp)

    def cells_at(self, xy: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the indices (M,) of the cells that contain pixel indices (M, 2), or -1 outside the grid and for
        NaN."""
        columns, rows = (np.rint((xy[:, axis] - self.pixels[0, axis]) / self.stride) for axis in (0, 1))
        height, width = self.shape
        inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
        return np.where(inside, np.nan_to_num(rows) * width + np.nan_to_num(columns), -1).astype(np.intp)


def index_intrinsics(camera: Camera) -> NDArray[np.float64]:
    """Return the intrinsic matrix (3, 3) for pixel indices: the centre of the first pixel is at (0, 0) instead of (0.5,
    0.5)."""
    k = camera.intrinsics.copy()
    k[:2, 2] -= 0.5
    return k


class PatchSimilarity:
    """Scores planes for the cells of one image. A plane maps the window around a cell to a part of each source image.
    The score measures the similarity between the window and these parts."""

    def __init__(self, view: GreyView, sources: Sequence[GreyView], grid: Grid) -> None:
        """Sample the windows of ``view`` at the cells of ``grid`` for comparison with ``sources``."""
        side = np.arange(-HALF_WINDOW, HALF_WINDOW + 1, dtype=np.float32) * STEP_PX
        self._across, self._down = (axis.reshape(-1, 1) for axis in np.meshgrid(side, side))
        self._pixels = grid.pixels
        self._sources = [(source.greys, _PlaneWarp.between(view.camera, source.camera)) for source in sources]
        self._levels = _window_levels(view, grid)
        self._windows = np.empty((len(self._across), len(grid.pixels)), np.float32)
        for level in range(LEVELS):
            cells = np.flatnonzero(self._levels == level)
            x = grid.pixels[cells, 0] + self._across * np.float32(2**level)
            y = grid.pixels[cells, 1] + self._down * np.float32(2**level)
            self._windows[:, cells] = _sample_grey(view.greys[level], x, y)
        count, std = _count_and_std(self._windows)
        centre = np.isfinite(self._windows[len(self._across) // 2])
        self.usable: NDArray[np.bool_] = centre & (count >= MIN_VISIBLE * len(self._across)) & (std > NOISE_STD)
        """(N,) bool, true for cells that can be matched.

        A cell can be matched if its centre and enough of its window are visible, and if the window's contrast exceeds
        the noise.
        """

    def scores(self, cells: NDArray[np.intp], planes: Floats) -> Floats:
        """Score planes (n, 3) of cells (n,).

        The score of a plane is the mean of its two highest correlations with source images, so that occlusion in the
        others does not lower it. If the cell is visible in only one source image, the score is the correlation with
        this image minus SINGLE_SOURCE_PENALTY.

        Returns:
            (n,) scores of at most 1, or -1 if the cell is visible in no source image.
        """
        out = np.empty(len(cells), np.float32)
        for level in range(LEVELS):
            rows = np.flatnonzero(self._levels[cells] == level)
            for begin in range(0, len(rows), BLOCK):
                block = rows[begin : begin + BLOCK]
                out[block] = self._block_scores(level, cells[block], planes[block])
        return out

    def _block_scores(self, level: int, cells: NDArray[np.intp], planes: Floats) -> Floats:
        best = np.full((2, len(cells)), UNKNOWN_SCORE, np.float32)
        windows, pixels = np.ascontiguousarray(self._windows[:, cells]), self._pixels[cells]
        across, down = self._across * np.float32(2**level), self._down * np.float32(2**level)
        for greys, warp in self._sources:
            rows = np.flatnonzero(warp.is_inside(pixels, planes, greys[level].shape))
            x, y = warp.sample_positions(pixels[rows], planes[rows], across, down)
            score = np.full(len(cells), UNKNOWN_SCORE, np.float32)
            score[rows] = _correlations(windows[:, rows], _sample_grey(greys[level], x, y))
            best[1] = np.maximum(best[1], np.minimum(best[0], score))
            best[0] = np.maximum(best[0], score)
        single = best[1] <= UNKNOWN_SCORE
        return np.where(single, best[0] - SINGLE_SOURCE_PENALTY * (best[0] > UNKNOWN_SCORE), best.mean(axis=0))


@dataclass(frozen=True, eq=False)
class _PlaneWarp:
    """Mapping of pixels from one image to another through a plane in space.

    A pixel index p = (x, y, 1) with inverse depth w maps to the homogeneous pixel index ``matrix @ p + w * shift``.
    """

    matrix: Floats
    shift: Floats

    @staticmethod
    def between(view: Camera, other: Camera) -> _PlaneWarp:
        """Create the warp from ``view`` into ``other``."""
        rotation = other.rotation @ view.rotation.T
        k = index_intrinsics(other)
        matrix = k @ rotation @ np.linalg.inv(index_intrinsics(view))
        shift = k @ (other.translation - rotation @ view.translation)
        return _PlaneWarp(matrix.astype(np.float32), shift.astype(np.float32))

    def is_inside(self, pixels: Floats, planes: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return a mask (n,) of the cells that project into the other image, which has the shape (H, W). A cell's
        centre ``pixels`` (n, 3) is mapped into the other image through the cell's plane (n, 3)."""
        x, y, depth = self._warp_centres(pixels, planes)
        height, width = shape
        return (depth > 0) & (x >= 0) & (y >= 0) & (x <= (width - 1) * depth) & (y <= (height - 1) * depth)

    def sample_positions(self, pixels: Floats, planes: Floats, across: Floats, down: Floats) -> tuple[Floats, Floats]:
        """Map the samples of n windows to positions x and y (o, n) in the other image. Each window has o samples at the
        offsets ``across`` and ``down`` from the cell centre.

        Positions are NaN for points behind the other camera.
        """
        middle = self._warp_centres(pixels, planes)
        by_x, by_y = (self.matrix[:, axis, None] + self.shift[:, None] * planes[:, axis] for axis in (0, 1))
        x, y, depth = (middle[row] + across * by_x[row] + down * by_y[row] for row in range(3))
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.where(depth > 1e-6, 1 / depth, np.float32(np.nan))
        return x * inverse, y * inverse

    def _warp_centres(self, pixels: Floats, planes: Floats) -> Floats:
        """Compute the homogeneous pixel indices (3, n) of the cell centres in the other image."""
        inverse = np.einsum("nc,nc->n", planes, pixels)
        # The product of matrix and pixels is written as a sum, because BLAS would start threads in each worker process.
        rotated = self.matrix[:, :1] * pixels[:, 0] + self.matrix[:, 1:2] * pixels[:, 1] + self.matrix[:, 2:]
        return np.asarray(rotated + self.shift[:, None] * inverse, np.float32)


def _window_levels(view: GreyView, grid: Grid) -> NDArray[np.int8]:
    """Choose the index (N,) of each cell's window size: the smallest size with enough texture in every direction, or
    the largest if none has enough."""
    level = np.full(len(grid.pixels), LEVELS - 1, np.int8)
    for index in reversed(range(LEVELS)):
        grey = np.nan_to_num(view.greys[index])
        step = STEP_PX * 2**index
        side = 2 * HALF_WINDOW * step + 1
        gx, gy = (cv2.filter2D(grey, -1, kernel) for kernel in _difference_kernels(step))
        xx, yy, xy = (cv2.boxFilter(a * b, -1, (side, side)) for a, b in ((gx, gx), (gy, gy), (gx, gy)))
        # The smaller eigenvalue of the window's structure tensor.
        eigenvalue = (xx + yy) / 2 - np.sqrt(np.maximum(((xx - yy) / 2) ** 2 + xy**2, 0))
        level[eigenvalue[grid.indices] > MIN_TEXTURE**2] = index
    return level


def _difference_kernels(step: int) -> tuple[Floats, Floats]:
    """Create horizontal and vertical kernels that compute grey differences over ``step`` pixels."""
    half = (step + 1) // 2
    kernel = np.zeros((1, 2 * half + 1), np.float32)
    kernel[0, 0], kernel[0, -1] = -step / (2 * half), step / (2 * half)
    return kernel, np.ascontiguousarray(kernel.T)


def _correlations(first: Floats, second: Floats) -> Floats:
    """Compute the correlations (n,) of windows (o, n) over the samples that are visible in both windows, or -1 if too
    few samples are visible."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    ab, aa, bb = (np.einsum("on,on->n", u, v) / len(first) for u, v in ((a, b), (a, a), (b, b)))
    correlation = ab / np.sqrt((aa + NOISE_STD**2) * (bb + NOISE_STD**2))
    partial = np.flatnonzero(np.isnan(correlation))
    if len(partial):
        correlation[partial] = _masked_correlations(first[:, partial], second[:, partial])
    return np.asarray(correlation, np.float32)


def _masked_correlations(first: Floats, second: Floats) -> Floats:
    """Compute the same correlations as :func:`_correlations`, for windows in which NaN marks invisible samples."""
    known = np.isfinite(first) & np.isfinite(second)
    count = known.sum(axis=0)
    out = np.full(len(count), UNKNOWN_SCORE, np.float32)
    enough = np.flatnonzero(count >= MIN_VISIBLE * len(first))
    known = known[:, enough]
    weight = known / count[enough].astype(np.float32)
    a, b = np.where(known, first[:, enough], 0), np.where(known, second[:, enough], 0)
    a -= (weight * a).sum(axis=0)
    b -= (weight * b).sum(axis=0)
    ab, aa, bb = ((weight * u * v).sum(axis=0) for u, v in ((a, b), (a, a), (b, b)))
    out[enough] = ab / np.sqrt((aa + NOISE_STD**2) * (bb + NOISE_STD**2))
    return out


def _count_and_std(windows: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Compute the number (n,) and the standard deviation (n,) of the visible samples in n windows of o samples."""
    known = np.isfinite(windows)
    count = known.sum(axis=0)
    share = np.maximum(count, 1)
    mean = np.where(known, windows, 0).sum(axis=0) / share
    return count, np.sqrt((np.where(known, windows - mean, 0) ** 2).sum(axis=0) / share)


def _sample_grey(grey: Floats, x: Floats, y: Floats) -> Floats:
    """Interpolate values bilinearly at pixel indices x and y. Values are NaN outside the image and at NaN positions."""
    if not x.size:
        return np.empty(x.shape, np.float32)
    height, width = grey.shape
    # cv2.remap accepts only a limited range of positions, so positions far outside the image are moved to about 9
    # pixels outside it. NaN positions are also moved outside it.
    x, y = np.fmax(np.fmin(x, width + 9), -9), np.fmax(np.fmin(y, height + 9), -9)
    outside = float("nan")
    return np.asarray(
        cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside), np.float32
    )
