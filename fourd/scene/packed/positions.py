"""Quantised positions, stored as sorted Morton codes (Morton 1966)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.morton import morton_codes
from fourd.scene.files.encoding import CloudEncoding


def encode_positions(xyz: NDArray[np.float32], encoding: CloudEncoding) -> NDArray[np.uint64]:
    """Return the Morton codes (N,) of positions (N, 3). Coordinates are clamped to the range of the encoding."""
    return morton_codes(_cells(xyz, encoding).astype(np.uint64))


def rounded_positions(xyz: NDArray[np.float32], encoding: CloudEncoding) -> NDArray[np.float32]:
    """Return the positions (N, 3) that readers decode for ``xyz`` (N, 3)."""
    return (encoding.lower + _cells(xyz, encoding) * encoding.position_step).astype(np.float32)


def _cells(xyz: NDArray[np.float32], encoding: CloudEncoding) -> NDArray[np.float64]:
    cells = np.rint((xyz - encoding.lower) / encoding.position_step)
    return np.clip(cells, 0, 2**encoding.position_bits - 1)
