"""Arrays whose first element is at the start of a cache line."""

from __future__ import annotations

from math import prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)

CACHE_LINE = 64
"""Size of a cache line in bytes, on all common processors. A row of 16 pixels of 4 bytes has the same size."""


def zeros_aligned(shape: tuple[int, ...], dtype: type[Number]) -> NDArray[Number]:
    """Make an array of zeros that starts at a multiple of :data:`CACHE_LINE`.

    NumPy aligns large arrays to 16 bytes. The renderers draw tiles of 16 x 16 pixels in parallel. In an image of
    4 bytes per pixel that is not aligned to cache lines, each row of a tile shares two cache lines with the
    neighbouring tiles, which other threads may draw at the same time.
    """
    size = prod(shape) * np.dtype(dtype).itemsize
    memory = np.zeros(size + CACHE_LINE, np.uint8)
    first = -memory.ctypes.data % CACHE_LINE
    return memory[first : first + size].view(dtype).reshape(shape)
