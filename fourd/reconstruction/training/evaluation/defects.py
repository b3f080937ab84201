"""Measures of visible defects that have little effect on the PSNR: errors at contours, specks, jumps between
viewpoints, and flicker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

CONTOUR_PX = 1.5
"""Pixels at most this far from the matte's contour, in pixels, belong to the class "contour"."""
NEAR_PX = 4.0
"""Pixels inside the matte belong to the class "near" if they are more than CONTOUR_PX and at most NEAR_PX from the
contour, and to the class "inside" if they are farther from it."""
WRONG_ALPHA = 0.3
"""Minimum difference between rendered alpha and matte at which the alpha is classified as wrong."""
SPECK_ERROR = 0.15
"""Minimum error of each pixel of a speck. The error is the largest absolute difference over the channels, for colours
in [0, 1]."""
SPECK_AREA_PX = 4
"""Maximum area of a speck in pixels. Larger regions of wrong pixels are not specks."""
MIN_SPECK_NEIGHBOURS = 5
"""The mask of :func:`speck_pixels` contains a pixel of a speck only if, for at least this number of its eight
neighbours, the error does not exceed SPECK_ERROR."""

Image = NDArray[np.float32]


@dataclass(frozen=True)
class ContourErrors:
    """Fractions in [0, 1] of an image's summed squared error that fall on four classes of pixels, by their distance
    from the matte's contour. The fractions add up to 1.

    Attributes:
        contour: at most CONTOUR_PX from the contour, on either side.
        near: inside the matte, more than CONTOUR_PX and at most NEAR_PX from the contour.
        inside: inside the matte, more than NEAR_PX from the contour.
        outside: outside the matte, more than CONTOUR_PX from the contour.
    """

    contour: float
    near: float
    inside: float
    outside: float


def contour_errors(prediction: Image, truth: Image, matte: NDArray[np.uint8]) -> ContourErrors:
    """Compute which fractions of the squared error between images (H, W, 3) in [0, 1] fall on the four classes of
    pixels around the contour of a matte (H, W)."""
    error = np.square(prediction - truth).sum(axis=-1)
    solid = (matte > 127).astype(np.uint8)
    inside = cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    outside = cv2.distanceTransform(1 - solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance = np.maximum(inside, outside) - 0.5
    near_contour = distance <= CONTOUR_PX
    bands = (
        near_contour,
        ~near_contour & (solid > 0) & (distance <= NEAR_PX),
        ~near_contour & (solid > 0) & (distance > NEAR_PX),
        ~near_contour & (solid == 0),
    )
    total = max(float(error.sum()), 1e-12)
    contour, near, deep, beyond = (float(error[band].sum()) / total for band in bands)
    return ContourErrors(contour, near, deep, beyond)


@dataclass(frozen=True)
class SilhouetteErrors:
    """Fractions in [0, 1] of an image's summed squared error that fall on pixels with a wrong alpha.

    Attributes:
        excess: fraction of the error where the rendered alpha exceeds the matte by more than WRONG_ALPHA.
        missing: fraction of the error where the rendered alpha is below the matte by more than WRONG_ALPHA.
    """

    excess: float
    missing: float


def silhouette_errors(
    prediction: Image, truth: Image, alpha: NDArray[np.float32], matte: NDArray[np.uint8]
) -> SilhouetteErrors:
    """Compute the fractions of the squared error at pixels where the rendered silhouette is too large or too small.

    Args:
        prediction: (H, W, 3) colours in [0, 1].
        truth: (H, W, 3) true colours in [0, 1].
        alpha: (H, W) rendered alpha of the foreground in [0, 1].
        matte: (H, W) true alpha, 255 for 1.
    """
    error = np.square(prediction - truth).sum(axis=-1)
    difference = alpha - matte.astype(np.float32) / 255
    total = max(float(error.sum()), 1e-12)
    excess, missing = error[difference > WRONG_ALPHA].sum(), error[difference < -WRONG_ALPHA].sum()
    return SilhouetteErrors(float(excess) / total, float(missing) / total)


def speck_pixels(prediction: Image, truth: Image) -> NDArray[np.bool_]:
    """Return a mask (H, W) that is true for the pixels that belong to specks.

    A speck is a connected region of at most SPECK_AREA_PX wrong pixels, whose errors exceed SPECK_ERROR. Of its pixels,
    only those with at least MIN_SPECK_NEIGHBOURS correct pixels among their eight neighbours are marked.

    Args:
        prediction: (H, W, 3) colours in [0, 1].
        truth: (H, W, 3) true colours in [0, 1].
    """
    wrong = (np.abs(prediction - truth).max(axis=-1) > SPECK_ERROR).astype(np.uint8)
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(wrong, connectivity=8)
    small = statistics[:count, cv2.CC_STAT_AREA] <= SPECK_AREA_PX
    small[0] = False
    wrong_neighbours = cv2.filter2D(wrong, cv2.CV_8U, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT) - wrong
    return small[labels] & (wrong_neighbours <= 8 - MIN_SPECK_NEIGHBOURS)


def jump_ratio(images: Sequence[Image]) -> float:
    """Compute the mean absolute differences of successive images, and divide the largest by the median.

    If the camera moves slowly in equal steps and the image changes smoothly, the ratio is close to 1.

    Args:
        images: at least 3 images (H, W, 3), rendered along a camera path.
    """
    steps = [float(np.abs(after - before).mean()) for before, after in pairwise(images)]
    return max(steps) / max(float(np.median(steps)), 1e-12)


def flicker(predictions: Sequence[Image], truths: Sequence[Image]) -> float:
    """Compute the mean absolute error of the image change from one frame to the next, for a camera that does not move.

    Args:
        predictions: at least 2 images (H, W, 3) of successive frames.
        truths: the true images of the same frames.
    """
    changes = zip(pairwise(predictions), pairwise(truths), strict=True)
    return float(np.mean([np.abs((p1 - p0) - (t1 - t0)).mean() for (p0, p1), (t0, t1) in changes]))
