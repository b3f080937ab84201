"""Background models of single pixels, computed from the colours of the pixels in all frames."""

from __future__ import annotations

import numpy as np

from fourd.recording.matting.motion.background_model import BackgroundModel, Deviations, fit_background, fit_deviations
from fourd.recording.matting.motion.colour_models import BINS, ColourHistogram


def test_the_colour_with_the_largest_weight_wins(rng: np.random.Generator) -> None:
    """Catches a plain median over the frames, which shows a subject that is present in most frames."""
    frames, size = 20, 12
    rgb = rng.integers(95, 105, (frames, size, size, 3)).astype(np.uint8)
    weights = np.full((frames, size, size), 0.02, np.float32)
    rgb[:6] = rng.integers(195, 205, (6, size, size, 3))
    weights[:6] = 1
    found = fit_background(rgb, weights, 3.0)
    assert np.abs(found.mean - 200).max() < 5
    assert found.confidence.min() == 1


def test_a_pixel_without_background_frames_is_not_confident(rng: np.random.Generator) -> None:
    """Catches pixels that no frame shows as background but that are reported as known background."""
    rgb = rng.integers(95, 105, (20, 4, 4, 3)).astype(np.uint8)
    found = fit_background(rgb, np.full((20, 4, 4), 0.02, np.float32), 3.0)
    assert found.confidence.max() < 0.2


def test_shadows_are_background_and_other_colours_are_not() -> None:
    """Catches shadows on the floor that are classified as foreground."""
    mean = np.full((1, 3, 3), (120.0, 100.0, 80.0), np.float32)
    background = BackgroundModel(mean, np.full_like(mean, 16), np.full((1, 3), 9, np.float32))
    seen = np.array([[(120, 100, 80), (84, 70, 56), (80, 100, 120)]], np.uint8)
    plain, shaded, other = background.log_likelihood(seen)[0]
    assert plain > shaded > other + 5


def test_histogram_is_a_density(rng: np.random.Generator) -> None:
    """Catches swapped channels and a density that does not integrate to one."""
    red = np.clip(rng.normal((200, 60, 40), 6, (5000, 3)), 0, 255).astype(np.uint8)
    colours = ColourHistogram.from_colours(red)
    total = np.exp(colours.log_density.astype(np.float64)).sum() * (256 / BINS) ** 3
    assert abs(total - 1) < 0.02
    inside, swapped = colours.log_likelihood(np.array([(200, 60, 40), (40, 60, 200)], np.uint8))
    assert inside > swapped + 5


def test_shares_of_shadow_and_change_are_learned(rng: np.random.Generator) -> None:
    """Catches a share of shadow that is not estimated from the images. Also catches unshadowed pixels that are counted
    as shadow, because a shadow of strength 1 also explains their colours.
    """
    count = 40_000
    mean = np.full((1, count, 3), (120.0, 100.0, 80.0), np.float32)
    background = BackgroundModel(mean, np.full_like(mean, 9), np.full((1, count), 9, np.float32))
    light = np.where(rng.random((1, count, 1)) < 0.1, 0.75, 1.0)
    seen = np.clip(mean * light + rng.normal(0, 3, mean.shape), 0, 255)
    seen[0, :2000] = (40, 90, 200)
    plain, shaded = background.plain_and_shaded(seen.astype(np.uint8))
    found = fit_deviations(plain[0], shaded[0], np.full(count, -14, np.float32))
    assert abs(found.shaded - 0.1) < 0.03
    assert abs(found.changed - 0.05) < 0.01
    nothing = np.zeros(0, np.float32)
    default = fit_deviations(nothing, nothing, nothing)
    assert np.allclose([default.shaded, default.changed], [Deviations.shaded, Deviations.changed])
