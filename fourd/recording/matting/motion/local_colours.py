"""Local colour histograms at the points of a coarse grid, smoothed spatially."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fourd.recording.matting.motion.colour_models import bin_indices, log_density

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

BINS = 16
SPREAD_BINS = 0.6
REACH_PX = 20.0
"""Standard deviation of the spatial smoothing in pixels."""
GLOBAL_WEIGHT = 4.0
"""Each local histogram is mixed with the histogram of the whole image, which has the weight of this number of pixels.

Both histograms count only the pixels that the argument ``counted`` of :meth:`LocalColours.from_picture` selects. At
grid points with few such pixels nearby, the histogram of the whole image dominates.
"""


@dataclass(frozen=True, eq=False)
class LocalColours:
    """Local colours of an image: one histogram over 8-bit RGB space for each point of a coarse grid on the image.

    Attributes:
        log_density: (rows, columns, bins ** 3) float32 log densities at the grid points.
        step_px: grid spacing in pixels.
        bins: number of bins along each colour axis.
    """

    log_density: Floats
    step_px: int
    bins: int

    @staticmethod
    def from_picture(
        rgb: Picture, counted: NDArray[np.bool_], reach_px: float = REACH_PX, bins: int = BINS
    ) -> LocalColours:
        """Compute local histograms of an image (h, w, 3) from the pixels for which ``counted`` (h, w) is True.

        ``reach_px`` is the standard deviation of the spatial smoothing in pixels. The grid spacing is half of
        ``reach_px``, so that interpolation artefacts are negligible. The run time is proportional to ``bins`` ** 3 /
        ``reach_px`` ** 2.
        """
        height, width = counted.shape
        step = max(1, round(reach_px / 2))
        rows, columns = height // step + 2, width // step + 2
        y, x = np.nonzero(counted)
        cells = ((y // step) * columns + x // step) * bins**3 + bin_indices(rgb[counted], bins)
        shape = (rows, columns, bins, bins, bins)
        counts = np.bincount(cells, minlength=rows * columns * bins**3).reshape(shape).astype(np.float32)
        reach = reach_px / step
        counts = gaussian_filter(counts, (reach, reach, *(SPREAD_BINS,) * 3), mode="constant", truncate=2.5)
        overall = counts.sum(axis=(0, 1))
        overall /= max(float(overall.sum()), 1e-9)
        total = counts.sum(axis=(2, 3, 4), keepdims=True)
        share = (counts + GLOBAL_WEIGHT * overall) / (total + GLOBAL_WEIGHT)
        return LocalColours(log_density(share, bins).reshape(rows, columns, -1), step, bins)

    def log_likelihood(self, rgb: Picture) -> Floats:
        """Return the log densities (h, w) at an image's colours (h, w, 3), interpolated bilinearly between grid
        points."""
        height, width = rgb.shape[:2]
        rows, columns = self.log_density.shape[:2]
        bins = bin_indices(rgb, self.bins)
        upper, down = _interpolation(height, rows, self.step_px)
        left, right = _interpolation(width, columns, self.step_px)
        down, right = down[:, None], right[None]

        def at(row: int, column: int) -> Floats:
            return self.log_density[(upper + row)[:, None], (left + column)[None], bins]

        above = (1 - right) * at(0, 0) + right * at(0, 1)
        below = (1 - right) * at(1, 0) + right * at(1, 1)
        return np.asarray((1 - down) * above + down * below, np.float32)


def _interpolation(size: int, points: int, step_px: int) -> tuple[NDArray[np.intp], Floats]:
    """Prepare linear interpolation along an image axis that has ``size`` pixels and ``points`` grid points, which are
    ``step_px`` pixels apart.

    Returns:
        For each pixel, the index of the grid point before the pixel, and the weight in [0, 1] of the next grid point.
    """
    position = (np.arange(size) + 0.5) / step_px - 0.5
    before = np.clip(np.floor(position), 0, points - 2).astype(np.intp)
    return before, np.clip(position - before, 0, 1).astype(np.float32)
