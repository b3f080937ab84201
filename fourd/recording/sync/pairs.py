"""Time offsets of cameras, computed from the time lags of pairs of cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
