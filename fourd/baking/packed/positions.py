"""Quantised positions as sorted Morton codes (Morton 1966)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.files.encoding import CloudEncoding
from fourd.morton import gather_bits, morton_codes


def encode_positions(xyz: NDArray[np.float32], encoding: CloudEncoding) -> NDArray[np.uint64]:
    """Return the Morton codes (N,) of positions (N, 3). Coordinates outside the encoding's range are clamped to it."""
    largest = 2**encoding.position_bits - 1
    cells = np.rint((xyz - encoding.lower) / encoding.position_step)
    return morton_codes(np.clip(cells, 0, largest).astype(np.uint64))


def decode_positions(codes: NDArray[np.uint64], encoding: CloudEncoding) -> NDArray[np.float32]:
    """Return the positions (N, 3) of Morton codes (N,)."""
    xyz = np.empty((len(codes), 3), np.float32)
    for axis in range(3):
        cells = gather_bits(codes >> np.uint64(axis))
        xyz[:, axis] = encoding.lower[axis] + cells * encoding.position_step
    return xyz
