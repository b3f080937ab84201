"""Colours of what lies near each pixel: histograms on a coarse grid, smoothed over the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fourd.matting.motion.colour_models import binned, log_density

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

BINS = 16
SPREAD_BINS = 0.6
REACH_PX = 20.0
"""Standard deviation of "near"."""
STEP_PX = 10
"""Of the grid; half the reach, so that the interpolation between its points does not show."""
ANYWHERE = 4.0
"""Pixels' worth of the colours of the whole picture, which stand where there is nothing near."""


@dataclass(frozen=True, eq=False)
class NearbyColours:
    """Log densities (rows, columns, BINS ** 3) float32 over RGB, per unit of 8-bit colour cubed, on a grid."""

    log_density: Floats

    @staticmethod
    def of(rgb: Picture, counted: NDArray[np.bool_]) -> NearbyColours:
        """The colours of a picture (h, w, 3) near each pixel, of those pixels that are ``counted`` (h, w)."""
        height, width = counted.shape
        rows, columns = height // STEP_PX + 2, width // STEP_PX + 2
        y, x = np.nonzero(counted)
        cells = ((y // STEP_PX) * columns + x // STEP_PX) * BINS**3 + binned(rgb[counted], BINS)
        shape = (rows, columns, BINS, BINS, BINS)
        counts = np.bincount(cells, minlength=rows * columns * BINS**3).reshape(shape).astype(np.float32)
        reach = REACH_PX / STEP_PX
        counts = gaussian_filter(counts, (reach, reach, *(SPREAD_BINS,) * 3), mode="constant", truncate=2.5)
        everywhere = counts.sum(axis=(0, 1))
        everywhere /= max(float(everywhere.sum()), 1e-9)
        near = counts.sum(axis=(2, 3, 4), keepdims=True)
        share = (counts + ANYWHERE * everywhere) / (near + ANYWHERE)
        return NearbyColours(log_density(share, BINS).reshape(rows, columns, -1))

    def log_likelihood(self, rgb: Picture) -> Floats:
        """(h, w) log densities of a picture's colours (h, w, 3), interpolated between the grid's points."""
        height, width = rgb.shape[:2]
        rows, columns = self.log_density.shape[:2]
        bins = binned(rgb, BINS)
        (upper, down), (left, right) = _between(height, rows), _between(width, columns)
        down, right = down[:, None], right[None]

        def at(row: int, column: int) -> Floats:
            return self.log_density[(upper + row)[:, None], (left + column)[None], bins]

        above = (1 - right) * at(0, 0) + right * at(0, 1)
        below = (1 - right) * at(1, 0) + right * at(1, 1)
        return np.asarray((1 - down) * above + down * below, np.float32)


def _between(size: int, points: int) -> tuple[NDArray[np.intp], Floats]:
    """Of each of ``size`` pixels the grid's point before it, and how far it is towards the next, in [0, 1]."""
    place = (np.arange(size) + 0.5) / STEP_PX - 0.5
    before = np.clip(np.floor(place), 0, points - 2).astype(np.intp)
    return before, np.clip(place - before, 0, 1).astype(np.float32)
