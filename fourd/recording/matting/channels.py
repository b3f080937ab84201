"""Reductions over the three channels of an image.

NumPy's own reductions are many times slower if the last axis has only three elements.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", np.uint8, np.float32)


def channel_sum(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the sum of ``picture``, an array of shape (..., 3), over its last axis."""
    return np.asarray(picture[..., 0] + picture[..., 1] + picture[..., 2], np.float32)


def channel_max(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return the maximum of ``picture``, an array of shape (..., 3), over its last axis."""
    return np.maximum(np.maximum(picture[..., 0], picture[..., 1]), picture[..., 2])


def channel_min(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return the minimum of ``picture``, an array of shape (..., 3), over its last axis."""
    return np.minimum(np.minimum(picture[..., 0], picture[..., 1]), picture[..., 2])
