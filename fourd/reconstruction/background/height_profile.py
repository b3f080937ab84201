"""Estimate a profile: colours that depend only on the height above the floor, such as those of a wall's rows of bricks,
boards or shelves. A profile can be extrapolated into directions that no camera sees. The cells in this module are those
of a grid of directions around the scene's centre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fourd.recording.stereo.directions import DirectionGrid

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

BIN_DEG = 0.5
"""Height of one bin of the profile, given as an angle. A bin spans this angle at the median distance of the cells whose
colours are to be extrapolated."""
SMOOTHING_DEG = (4.0, 10.0)
"""Standard deviations, in elevation and azimuth, of the Gaussian filter that separates the profile from slow colour
changes."""
SECTORS = 24
"""Number of azimuth sectors in which the profile is measured independently."""
MIN_SECTORS = 3
"""Minimum number of sectors with known cells at a height. If there are fewer, the profile at this height is 0."""


def height_profile(grid: DirectionGrid, known: Bools, inverse_distance: Array, rgb: Array) -> Array:
    """Estimate the part of the colours that depends only on the height.

    The smoothed colours of known cells are subtracted from their colours. The profile at a height is the mean of these
    differences over all azimuth sectors, multiplied by the positive-part James-Stein factor. The factor is near 1 if
    the sectors agree, and 0 if the mean is not larger than its standard error. For surfaces without horizontal stripes,
    the profile is therefore near 0.

    Args:
        grid: the grid of directions.
        known: (cells,) bool, true for cells with a given colour.
        inverse_distance: (cells,) inverse distance to the surface, extrapolated to unknown cells.
        rgb: (cells, 3) colours in [0, 255]. The colours of unknown cells are ignored.

    Returns:
        (cells, 3) colour difference at the height of each cell, known or unknown. The caller subtracts this difference
        from the known colours, extrapolates the result to the unknown cells, and then adds the difference to all cells.
    """
    if known.all() or not known.any():
        return np.zeros_like(rgb)
    local = grid.directions() @ grid.R_world_sphere / np.maximum(inverse_distance, 1e-12)[:, None]
    distance = np.linalg.norm(local, axis=1)
    bins = np.floor(local[:, 2] / (np.radians(BIN_DEG) * np.median(distance[~known]))).astype(np.int64)
    heights, height = np.unique(bins, return_inverse=True)
    difference = (rgb - _smooth(grid, known, rgb))[known]
    column = np.tile(np.arange(grid.columns), grid.rows)[known]
    group = height[known] * SECTORS + column * SECTORS // grid.columns
    size = np.bincount(group, minlength=len(heights) * SECTORS)
    total = np.stack([np.bincount(group, difference[:, channel], len(size)) for channel in range(3)], axis=-1)
    means = (total / np.maximum(size, 1)[:, None]).reshape(len(heights), SECTORS, 3)
    return np.asarray(_shrink(means, (size > 0).reshape(len(heights), SECTORS))[height])


def _smooth(grid: DirectionGrid, known: Bools, rgb: Array) -> Array:
    """Smooth the colours (cells, 3) over the known cells."""
    shape = (grid.rows, grid.columns)
    sigma = (SMOOTHING_DEG[0] * grid.rows / 180, SMOOTHING_DEG[1] * grid.columns / 360)

    def smooth(values: Array) -> Array:
        return np.asarray(gaussian_filter(values.reshape(shape), sigma, mode=("nearest", "wrap")).ravel())

    weight = np.maximum(smooth(known.astype(np.float64)), 1e-6)
    return np.stack([smooth(np.where(known, rgb[:, channel], 0)) / weight for channel in range(3)], axis=-1)


def _shrink(means: Array, measured: Bools) -> Array:
    """Average the sectors' means (heights, sectors, 3) over the sectors for which the mask ``measured`` (heights,
    sectors) is true, and multiply the result (heights, 3) by the positive-part James-Stein factor."""
    count = measured.sum(axis=1)
    weight = (measured / np.maximum(count, 1)[:, None])[..., None]
    mean = (weight * means).sum(axis=1)
    variance = (weight * (means - mean[:, None]) ** 2).sum(axis=(1, 2)) / np.maximum(count - 1, 1)
    power = np.maximum((mean**2).sum(axis=1), 1e-12)
    factor = np.where(count >= MIN_SECTORS, np.maximum(1 - variance / power, 0), 0)
    return np.asarray(factor[:, None] * mean)
