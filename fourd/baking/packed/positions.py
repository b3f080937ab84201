"""Quantised positions, stored as sorted Morton codes (Morton 1966)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.files.encoding import CloudEncoding
from fourd.ops.morton import morton_codes


def encode_positions(xyz: NDArray[np.float32], encoding: CloudEncoding) -> NDArray[np.uint64]:
    """Return the Morton codes (N,) of positions (N, 3). Coordinates outside the range of the encoding are clamped to
    this range."""
    largest = 2**encoding.position_bits - 1
    cells = np.rint((xyz - encoding.lower) / encoding.position_step)
    return morton_codes(np.clip(cells, 0, largest).astype(np.uint64))
