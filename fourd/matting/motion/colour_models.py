"""Colour distributions as smoothed histograms, and how likely they make a picture's colours."""

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
"""Share of the distribution spread over all colours: one that was not seen is not impossible."""


@dataclass(frozen=True, eq=False)
class Colours:
    """Log densities (BINS, BINS, BINS) float32 over RGB, per unit of 8-bit colour cubed."""

    log_density: Floats

    @staticmethod
    def of(rgb: Picture, weights: NDArray[np.floating] | None = None) -> Colours:
        """The distribution of colours (N, 3) uint8, with weights (N,) where given."""
        counts = np.bincount(binned(rgb, BINS), weights=weights, minlength=BINS**3).reshape(BINS, BINS, BINS)
        smooth = gaussian_filter(counts.astype(np.float64), SPREAD_BINS)
        return Colours(log_density(smooth / max(float(smooth.sum()), 1e-9), BINS))

    @staticmethod
    def mixed(distributions: Sequence[Colours], shares: Sequence[float] | None = None) -> Colours:
        """The mixture of distributions, in equal parts unless ``shares``, which add up to 1, are given."""
        weights = np.full(len(distributions), 1 / len(distributions)) if shares is None else np.asarray(shares)
        density = sum(
            weight * np.exp(colours.log_density) for weight, colours in zip(weights, distributions, strict=True)
        )
        return Colours(np.log(density).astype(np.float32))

    def log_likelihood(self, rgb: Picture) -> Floats:
        """Log densities (...,) of colours (..., 3) uint8."""
        return self.log_density.ravel()[binned(rgb, BINS)]


def log_density(shares: NDArray[np.floating], bins: int) -> Floats:
    """Per unit of 8-bit colour cubed, of the shares (...) that bins, ``bins`` along each axis, have of all."""
    return np.log((1 - UNIFORM) * shares * (bins / 256) ** 3 + UNIFORM / 256**3).astype(np.float32)


def binned(rgb: Picture, bins: int) -> NDArray[np.int32]:
    """(...,) places of colours (..., 3) in a flat histogram of ``bins`` ** 3."""
    places = (rgb.astype(np.int32) * bins) >> 8
    return np.asarray((places[..., 0] * bins + places[..., 1]) * bins + places[..., 2], np.int32)
