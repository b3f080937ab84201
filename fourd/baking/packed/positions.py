"""Quantised positions as sorted Morton codes (Morton 1966)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.files.encoding import CloudEncoding

_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""Shifts and masks that insert two zero bits before each of the 21 lowest bits of a number, one after another."""
_LOWEST_21_BITS = 0x1FFFFF


def encode_positions(xyz: NDArray[np.float32], encoding: CloudEncoding) -> NDArray[np.uint64]:
    """Return the Morton codes (N,) of positions (N, 3). Coordinates outside the encoding's range are clamped to it."""
    largest = 2**encoding.position_bits - 1
    cells = np.rint((xyz - encoding.lower) / encoding.position_step)
    cells = np.clip(cells, 0, largest).astype(np.uint64)
    return (
        spread_bits(cells[:, 0]) | spread_bits(cells[:, 1]) << np.uint64(1) | spread_bits(cells[:, 2]) << np.uint64(2)
    )


def decode_positions(codes: NDArray[np.uint64], encoding: CloudEncoding) -> NDArray[np.float32]:
    """Return the positions (N, 3) of Morton codes (N,)."""
    xyz = np.empty((len(codes), 3), np.float32)
    for axis in range(3):
        cells = gather_bits(codes >> np.uint64(axis))
        xyz[:, axis] = encoding.lower[axis] + cells * encoding.position_step
    return xyz


def spread_bits(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Insert two zero bits before each of the 21 lowest bits of every value."""
    for shift, mask in _SPREAD:
        values = (values | values << np.uint64(shift)) & np.uint64(mask)
    return values


def gather_bits(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return the values of :func:`spread_bits`. Other bits of ``values`` are ignored."""
    values = values & np.uint64(_SPREAD[-1][1])
    masks = [mask for _, mask in _SPREAD[-2::-1]] + [_LOWEST_21_BITS]
    for (shift, _), mask in zip(reversed(_SPREAD), masks, strict=True):
        values = (values | values >> np.uint64(shift)) & np.uint64(mask)
    return values
