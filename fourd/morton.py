"""Morton order (Z-order curve): points that are close in space are stored close together in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BITS = 10
"""Number of bits per axis. The Morton code of three axes then fits in 32 bits."""


def morton_order(xyz: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the indices (N,) that stably sort points (N, 3) in Morton order (Morton 1966). Points must be finite."""
    if len(xyz) == 0:
        return np.zeros(0, np.int64)
    lower = xyz.min(axis=0).astype(np.float64)
    side = max(float((xyz.max(axis=0) - lower).max()), 1e-30)
    cells = ((xyz - lower) * ((2**BITS - 1) / side)).astype(np.uint32)
    codes = _spread_bits(cells[:, 0]) | _spread_bits(cells[:, 1]) << 1 | _spread_bits(cells[:, 2]) << 2
    return np.argsort(codes, kind="stable")


def _spread_bits(values: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Insert two zero bits before each of the ten lowest bits of every value."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        values = (values | values << np.uint32(shift)) & np.uint32(mask)
    return values
