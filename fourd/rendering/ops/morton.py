"""Morton order (Z-order curve), which stores points that are close in space close together in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BITS = 10
"""Number of bits per axis that :func:`morton_order` compares."""
MAX_BITS = 21
"""Maximum number of bits per axis, which gives Morton codes of 63 bits."""
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""Pairs (shift, mask) for the steps that move bit b of a number to bit 3 * b, for its MAX_BITS lowest bits."""
_LOWEST_BITS = 2**MAX_BITS - 1


def morton_order(xyz: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the indices (N,) that sort finite points (N, 3) stably in Morton order (Morton 1966)."""
    if len(xyz) == 0:
        return np.zeros(0, np.int64)
    lower = xyz.min(axis=0).astype(np.float64)
    side = max(float((xyz.max(axis=0) - lower).max()), 1e-30)
    cells = ((xyz - lower) * ((2**BITS - 1) / side)).astype(np.uint64)
    return np.argsort(morton_codes(cells), kind="stable")


def morton_codes(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return the Morton codes (N,) of cells (N, 3) with coordinates below 2^21. Bit b of axis a becomes bit 3 * b + a
    of the code."""
    x, y, z = (spread_bits(cells[:, axis]) << np.uint64(axis) for axis in range(3))
    return x | y | z


def spread_bits(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Move bit b of every value to bit 3 * b. The values are below 2^21, and all other bits of the results are 0."""
    for shift, mask in _SPREAD:
        values = (values | values << np.uint64(shift)) & np.uint64(mask)
    return values


def gather_bits(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Invert :func:`spread_bits`: collect every third bit of each value, starting with bit 0, and ignore the other
    bits."""
    values = values & np.uint64(_SPREAD[-1][1])
    masks = [mask for _, mask in _SPREAD[-2::-1]] + [_LOWEST_BITS]
    for (shift, _), mask in zip(reversed(_SPREAD), masks, strict=True):
        values = (values | values >> np.uint64(shift)) & np.uint64(mask)
    return values
