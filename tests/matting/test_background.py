"""The background of a pixel, told from its frames."""

from __future__ import annotations

import numpy as np

from fourd.matting.motion.background_model import Background, commonest
from fourd.matting.motion.colour_models import BINS, Colours


def test_the_colour_of_most_weight_wins_though_few_frames_show_it(rng: np.random.Generator) -> None:
    """Catches a plain median, which keeps a subject who stays for most of the time."""
    frames, size = 20, 12
    rgb = rng.integers(95, 105, (frames, size, size, 3)).astype(np.uint8)
    weights = np.full((frames, size, size), 0.02, np.float32)
    rgb[:6] = rng.integers(195, 205, (6, size, size, 3))
    weights[:6] = 1
    found = commonest(rgb, weights, 3.0)
    assert np.abs(found.mean - 200).max() < 5
    assert found.sureness.min() == 1


def test_a_pixel_that_never_shows_it_is_not_sure(rng: np.random.Generator) -> None:
    """Catches holes that are taken for known background."""
    rgb = rng.integers(95, 105, (20, 4, 4, 3)).astype(np.uint8)
    found = commonest(rgb, np.full((20, 4, 4), 0.02, np.float32), 3.0)
    assert found.sureness.max() < 0.2


def test_shadow_is_background_and_another_colour_is_not() -> None:
    """Catches shadows on the floor that become part of the subject."""
    mean = np.full((1, 3, 3), (120.0, 100.0, 80.0), np.float32)
    background = Background(mean, np.full_like(mean, 16), np.full((1, 3), 9, np.float32))
    seen = np.array([[(120, 100, 80), (84, 70, 56), (80, 100, 120)]], np.uint8)
    plain, shaded, other = background.log_likelihood(seen)[0]
    assert plain > shaded > other + 5


def test_colours_of_a_distribution_are_likelier_within_it(rng: np.random.Generator) -> None:
    """Catches swapped channels and a density that is not one."""
    red = np.clip(rng.normal((200, 60, 40), 6, (5000, 3)), 0, 255).astype(np.uint8)
    colours = Colours.of(red)
    total = np.exp(colours.log_density.astype(np.float64)).sum() * (256 / BINS) ** 3
    assert abs(total - 1) < 0.02
    inside, swapped = colours.log_likelihood(np.array([(200, 60, 40), (40, 60, 200)], np.uint8))
    assert inside > swapped + 5
