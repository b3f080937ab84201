"""Colour distributions as smoothed RGB histograms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

BINS = 24
SPREAD_BINS = 0.8
UNIFORM = 0.02
"""Each histogram is mixed with the uniform distribution, which has this weight, so that unobserved colours have a
positive density."""


@dataclass(frozen=True, eq=False)
class ColourHistogram:
    """Colour distribution: log densities (BINS, BINS, BINS) float32 over 8-bit RGB space."""

    log_density: Floats

    @staticmethod
    def from_colours(rgb: Picture, weights: NDArray[np.floating] | None = None) -> ColourHistogram:
        """Estimate the distribution of colours (N, 3) uint8 with optional weights (N,)."""
        counts = np.bincount(bin_indices(rgb, BINS), weights=weights, minlength=BINS**3).reshape(BINS, BINS, BINS)
        smooth = gaussian_filter(counts.astype(np.float64), SPREAD_BINS)
        return ColourHistogram(log_density(smooth / max(float(smooth.sum()), 1e-9), BINS))

    @staticmethod
    def mixture(distributions: Sequence[ColourHistogram], shares: Sequence[float] | None = None) -> ColourHistogram:
        """Mix distributions with weights ``shares`` that sum to 1. If ``shares`` is None, all weights are equal."""
        weights = np.full(len(distributions), 1 / len(distributions)) if shares is None else np.asarray(shares)
        density = sum(
            weight * np.exp(colours.log_density) for weight, colours in zip(weights, distributions, strict=True)
        )
        return ColourHistogram(np.log(density).astype(np.float32))

    def log_likelihood(self, rgb: Picture) -> Floats:
        """Return the log density of each colour in ``rgb``, a uint8 array whose last axis has the three channels."""
        return self.log_density.ravel()[bin_indices(rgb, BINS)]


def log_density(shares: NDArray[np.floating], bins: int) -> Floats:
    """Convert an RGB histogram to log probability densities over 8-bit RGB space.

    The histogram has ``bins`` bins along each colour axis. ``shares`` is an array of any shape, whose elements are the
    fractions of all samples in the histogram's bins.
    """
    return np.log((1 - UNIFORM) * shares * (bins / 256) ** 3 + UNIFORM / 256**3).astype(np.float32)


def bin_indices(rgb: Picture, bins: int) -> NDArray[np.int32]:
    """Return the index of each colour's bin in a flattened RGB histogram.

    Args:
        rgb: (..., 3) uint8 colours.
        bins: number of bins of the histogram along each colour axis.

    Returns:
        (...) int32 indices, one per colour.
    """
    bin_rgb = (rgb.astype(np.int32) * bins) >> 8
    return np.asarray((bin_rgb[..., 0] * bins + bin_rgb[..., 1]) * bins + bin_rgb[..., 2], np.int32)
