"""Time offsets of cameras, computed from the time lags of pairs of cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PEAK_RADIUS = 3
"""Values at most this many lags away from the highest one belong to the same peak."""


@dataclass(frozen=True)
class Peak:
    """The highest value of a correlation over lags.

    Attributes:
        index: index of the highest value.
        position: ``index``, moved by a fraction to the vertex of the parabola through the highest value and its
            neighbours.
        height: the highest value.
        lead: difference to the highest value outside the peak, or to 0 if all of these are negative.
    """

    index: int
    position: float
    height: float
    lead: float


def find_peak(scores: Array) -> Peak:
    """Find the peak of the correlations ``scores`` (L,) at L consecutive lags."""
    top = int(scores.argmax())
    height = float(scores[top])
    others = np.delete(scores, np.arange(max(top - PEAK_RADIUS, 0), min(top + PEAK_RADIUS + 1, len(scores))))
    lead = height - max(float(others.max(initial=0)), 0.0)
    fraction = 0.0
    if 0 < top < len(scores) - 1:
        left, right = float(scores[top - 1]), float(scores[top + 1])
        curvature = left - 2 * height + right
        fraction = 0.5 * (left - right) / curvature if curvature < -1e-12 else 0.0
    return Peak(top, top + fraction, height, lead)


def solve_offsets(
    pairs: Sequence[tuple[int, int]], lags: Array, pair_weights: Array, count: int, tolerance: float
) -> Array:
    """Fit one offset per camera to the lags of the pairs, and return the offsets as an array (count,). The first
    camera's offset is 0.

    The fit uses iteratively reweighted least squares, which approximates least absolute deviations. A camera whose
    pairs all have weight 0 gets offset 0.

    Args:
        pairs: indices (i, j) of the two cameras of each pair.
        lags: (P,) offset of camera j minus offset of camera i, in any unit of time.
        pair_weights: (P,) weights in [0, 1].
        count: number of cameras.
        tolerance: a pair has its full weight if its lag deviates from the difference of the two cameras' fitted offsets
            by at most this value, in the unit of the lags.
    """
    if not pairs:
        return np.zeros(count)
    design = np.zeros((len(pairs), count))
    for row, (i, j) in enumerate(pairs):
        design[row, i], design[row, j] = -1, 1
    design = design[:, 1:]
    weights = pair_weights**2 + 1e-9
    solution: Array = np.zeros(count - 1)
    for _ in range(30):
        root = np.sqrt(weights)
        solution = np.asarray(np.linalg.lstsq(root[:, None] * design, root * lags, rcond=None)[0], np.float64)
        weights = (pair_weights**2 + 1e-9) / np.maximum(np.abs(design @ solution - lags), tolerance)
    return np.concatenate([[0.0], solution])


def camera_confidence(weights: Sequence[float]) -> float:
    """Return the confidence of a camera, given the weights of all pairs that include it: the mean of the larger half of
    the weights. If there is only one camera, the confidence is 1."""
    better = sorted(weights, reverse=True)[: (len(weights) + 1) // 2]
    return float(np.mean(better)) if better else 1.0
