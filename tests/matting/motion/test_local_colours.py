"""Local colour histograms."""

from __future__ import annotations

import numpy as np

from fourd.recording.matting.channels import channel_max, channel_min, channel_sum
from fourd.recording.matting.motion.colour_models import BINS as COARSE_BINS
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.local_colours import BINS, LocalColours

RED, BLUE = (200, 40, 40), (40, 40, 200)


def halves(height: int = 90, width: int = 240) -> np.ndarray:
    picture = np.empty((height, width, 3), np.uint8)
    picture[:, : width // 2], picture[:, width // 2 :] = RED, BLUE
    return picture


def test_colours_are_likelier_where_they_occur() -> None:
    """Catches a transposed or shifted grid, and a histogram of the whole image instead of local histograms."""
    picture = halves()
    nearby = LocalColours.from_picture(picture, np.ones(picture.shape[:2], bool))
    red = nearby.log_likelihood(np.full_like(picture, RED))
    blue = nearby.log_likelihood(np.full_like(picture, BLUE))
    assert (red[:, :40] > blue[:, :40] + 2).all()
    assert (blue[:, -40:] > red[:, -40:] + 2).all()
    assert np.abs(red - blue)[:, 120].max() < 1
    assert np.abs(np.diff(red, axis=1)).max() < 0.5, "no steps between grid points"


def test_densities_integrate_to_one() -> None:
    """Catches log-odds that are off by a constant factor."""
    picture = halves()
    counted = np.zeros(picture.shape[:2], bool)
    counted[10:30, 100:140] = True
    densities = np.exp(LocalColours.from_picture(picture, counted).log_density.astype(np.float64))
    assert np.abs(densities.sum(axis=-1) * (256 / BINS) ** 3 - 1).max() < 0.02


def test_global_histogram_is_used_without_pixels_nearby() -> None:
    """Catches a division of zero by zero. Also catches uniform densities far from all selected pixels, where the global
    histogram must be used."""
    picture = halves()
    counted = np.zeros(picture.shape[:2], bool)
    counted[:, :20] = True
    far = LocalColours.from_picture(picture, counted).log_likelihood(picture)
    assert np.isfinite(far).all()
    unknown = LocalColours.from_picture(picture, np.zeros_like(counted)).log_likelihood(picture)
    assert np.ptp(unknown) < 1e-3
    red = LocalColours.from_picture(picture, counted).log_likelihood(np.full_like(picture, RED))
    assert red[:, -1].min() > unknown.max() + 3


def test_mixture_averages_densities(rng: np.random.Generator) -> None:
    """Catches an average of log-densities, which makes a colour impossible if one camera does not see this colour."""
    red, blue = (ColourHistogram.from_colours(np.tile(np.array(colour, np.uint8), (500, 1))) for colour in (RED, BLUE))
    mixture = ColourHistogram.mixture([red, blue], [0.7, 0.3])
    seen = np.array([RED, BLUE], np.uint8)
    own = np.array([red.log_likelihood(seen)[0], blue.log_likelihood(seen)[1]])
    assert np.allclose(mixture.log_likelihood(seen), own + np.log([0.7, 0.3]), atol=0.01)
    total = np.exp(mixture.log_density.astype(np.float64)).sum() * (256 / COARSE_BINS) ** 3
    assert abs(total - 1) < 0.01


def test_channel_reductions_match_numpy(rng: np.random.Generator) -> None:
    """Catches a colour channel that is missing in a sum, minimum or maximum."""
    picture = rng.normal(size=(3, 5, 4, 3)).astype(np.float32)
    assert np.allclose(channel_sum(picture), picture.sum(axis=-1), atol=1e-5)
    assert np.array_equal(channel_max(picture), picture.max(axis=-1))
    assert np.array_equal(channel_min(picture), picture.min(axis=-1))
