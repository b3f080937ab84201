"""Measures of visible defects, on images whose defects are known."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from fourd.reconstruction.training.evaluation.defects import (
    contour_errors,
    flicker,
    jump_ratio,
    silhouette_errors,
    speck_pixels,
)


def disc(size: int = 64, radius: float = 20.0) -> np.ndarray:
    """Matte (H, W), uint8, of a disc in the middle of the image."""
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.where(np.hypot(x, y) <= radius, 255, 0).astype(np.uint8)


@pytest.mark.parametrize(
    ("row", "column", "place"),
    [(32, 32, "inside"), (32, 32 + 17, "near"), (32, 32 + 19, "contour"), (32, 32 + 20, "contour"), (2, 2, "outside")],
)
def test_errors_are_assigned_to_their_distance_from_the_contour(row: int, column: int, place: str) -> None:
    """Catches swapped bands, and a contour band that covers one side of the contour only."""
    truth = np.zeros((64, 64, 3), np.float32)
    prediction = truth.copy()
    prediction[row, column] = 0.5
    shares = contour_errors(prediction, truth, disc())
    assert getattr(shares, place) == pytest.approx(1.0)
    assert sum(astuple(shares)) == pytest.approx(1.0)


def test_equal_images_have_no_contour_error() -> None:
    """Catches a division by zero for equal images."""
    image = np.full((64, 64, 3), 0.3, np.float32)
    assert astuple(contour_errors(image, image, disc())) == (0.0, 0.0, 0.0, 0.0)


def test_silhouette_errors_tell_excess_from_missing() -> None:
    """Catches a swapped sign, and wrong colours inside a correct silhouette that count as wrong silhouette."""
    truth, matte = np.zeros((8, 8, 3), np.float32), np.zeros((8, 8), np.uint8)
    matte[:, :4], truth[:, :4] = 255, 1
    prediction, alpha = truth.copy(), matte.astype(np.float32) / 255
    prediction[0, 6], alpha[0, 6] = 1, 1
    prediction[0:2, 0], alpha[0:2, 0] = 0, 0.2
    prediction[5, 1] = 0
    shares = silhouette_errors(prediction, truth, alpha, matte)
    assert (shares.excess, shares.missing) == pytest.approx((0.25, 0.5))


def test_single_wrong_pixels_are_specks_and_wrong_regions_are_not() -> None:
    """Catches a measure that counts blurred regions or long wrong edges as specks."""
    truth = np.full((40, 40, 3), 0.5, np.float32)
    prediction = truth.copy()
    prediction[5, 5, 1] += 0.2
    prediction[10, 10] += 0.1
    prediction[20:24, 20:24] = 0
    prediction[30, 5:30] = 0
    assert np.argwhere(speck_pixels(prediction, truth)).tolist() == [[5, 5]]


def test_a_pair_of_wrong_pixels_is_one_speck() -> None:
    """Catches a measure that misses specks of two pixels, and specks at the border of the image."""
    truth = np.full((40, 40, 3), 0.5, np.float32)
    prediction = truth.copy()
    prediction[8, 8:10] = 1
    prediction[0, 0] = 1
    assert np.argwhere(speck_pixels(prediction, truth)).tolist() == [[0, 0], [8, 8], [8, 9]]


def test_a_jump_is_measured_against_the_median_step() -> None:
    """Catches a ratio to the mean step instead of the median step. The jump itself would increase the mean."""
    levels = [0.0, 0.1, 0.2, 0.5, 0.6, 0.7]
    images = [np.full((4, 4, 3), level, np.float32) for level in levels]
    assert jump_ratio(images) == pytest.approx(3.0, rel=1e-4)


def test_true_changes_are_not_flicker() -> None:
    """Catches a measure that counts the subject's own motion as flicker."""
    truths = [np.full((4, 4, 3), level, np.float32) for level in (0.1, 0.4, 0.2)]
    shifted = [truth + 0.05 for truth in truths]
    unsteady = [truths[0], truths[1] + 0.1, truths[2]]
    assert flicker(shifted, truths) == pytest.approx(0.0, abs=1e-6)
    assert flicker(unsteady, truths) == pytest.approx(0.1, abs=1e-6)
