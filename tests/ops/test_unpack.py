"""The decoder of packed scenes against its references in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.rendering.ops.unpack.op import unpack_harmonics, unpack_positions, unpack_views
from fourd.rendering.ops.unpack.reference import (
    unpack_harmonics_reference,
    unpack_positions_reference,
    unpack_views_reference,
)


@pytest.mark.parametrize("code_bytes", [1, 3, 8])
def test_positions_equal_the_reference(code_bytes: int, rng: np.random.Generator) -> None:
    """Catches mixed-up axes, and codes that are not summed modulo 2^64."""
    content = rng.integers(0, 256, code_bytes * 300).astype(np.uint8)
    arguments = (content, rng.normal(size=3), 1e-3, 300)
    found, expected = unpack_positions(*arguments), unpack_positions_reference(*arguments)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_positions_of_another_size_are_refused() -> None:
    """Catches a kernel that reads past the end of a short member."""
    assert unpack_positions(np.zeros(0, np.uint8), np.zeros(3), 1.0, 0).shape == (0, 3)
    for size in (7, 36):
        with pytest.raises(ValueError, match="content: expected 1 to 8 bytes for each point"):
            unpack_positions(np.zeros(size, np.uint8), np.zeros(3), 1.0, 4)


@pytest.mark.parametrize("points", [0, 1, 63, 64, 65, 500])
@pytest.mark.parametrize("rows", [0, 1, 7, 48])
def test_harmonics_equal_the_reference(points: int, rows: int, rng: np.random.Generator) -> None:
    """Catches a wrong sign of zigzag codes, and blocks at the end of the points that are left out."""
    content = rng.integers(0, 256, (2, rows * points)).astype(np.uint8)
    content[1] &= 3
    basis = (rng.normal(size=(rows, 48)) / 50).astype(np.float32)
    mean = rng.normal(size=48).astype(np.float32)
    found = unpack_harmonics(content.ravel(), basis, mean, points)
    expected = unpack_harmonics_reference(content.ravel(), basis, mean, points)
    np.testing.assert_allclose(found.astype(np.float64), expected.astype(np.float64), rtol=2e-3, atol=1e-3)


def test_halves_are_rounded_to_nearest() -> None:
    """Catches a conversion to float16 that truncates, or that is wrong for subnormal and large numbers."""
    mean = np.array([0, 1e-8, 3e-8, 6e-8, 5.9e-5, 6.2e-5, 1 + 2**-11, 1 + 3 * 2**-11, 65504, 1e6], np.float32)
    mean = np.concatenate([mean, -mean, np.linspace(-3, 3, 28, dtype=np.float32)])
    found = unpack_harmonics(np.zeros(0, np.uint8), np.zeros((0, 48), np.float32), mean, 1)[0]
    np.testing.assert_array_equal(found, np.clip(mean, -65504, 65504).astype(np.float16))


@pytest.mark.parametrize("every_point_has_colours", [False, True])
@pytest.mark.parametrize("colour_step", [1, 2, 5, 127])
def test_views_equal_the_reference(colour_step: int, every_point_has_colours: bool, rng: np.random.Generator) -> None:
    """Catches colours that are assigned to the wrong points. Also catches sums that wrap around where they must be
    clamped, and sums that are clamped where they must wrap around.
    """
    points, contents = 150, []
    for share in (0.0, 0.5, 1.0):
        codes = (rng.integers(1, 256, points) * (rng.random(points) < share)).astype(np.uint8)
        colours = points if every_point_has_colours else int(np.count_nonzero(codes))
        contents.append(np.concatenate([codes, rng.integers(0, 256, 3 * colours).astype(np.uint8)]))
    mean = rng.integers(0, 256, (points, 3)).astype(np.uint8)
    weights = rng.random(256).astype(np.float16)
    arguments = (contents, mean, weights, colour_step)
    found = unpack_views(*arguments, every_point_has_colours=every_point_has_colours)
    expected = unpack_views_reference(*arguments, every_point_has_colours=every_point_has_colours)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_contents_of_other_sizes_are_refused() -> None:
    """Catches a kernel that reads past the end of a short member."""
    mean, weights = np.zeros((4, 3), np.uint8), np.zeros(256, np.float16)
    codes = np.array([0, 1, 1, 0], np.uint8)
    for content in (codes[:3], np.concatenate([codes, np.zeros(5, np.uint8)])):
        with pytest.raises(ValueError, match="contents: expected"):
            unpack_views([content], mean, weights, 1, every_point_has_colours=False)
    with pytest.raises(ValueError, match="content: expected two bytes"):
        unpack_harmonics(np.zeros(7, np.uint8), np.zeros((1, 48), np.float32), np.zeros(48, np.float32), 4)
