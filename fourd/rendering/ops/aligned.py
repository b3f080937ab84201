"""NumPy arrays that are aligned to cache lines, and to huge pages if they are large."""

from __future__ import annotations

from math import prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)

CACHE_LINE = 64
"""Cache line size in bytes on all common processors. A row of 16 pixels of 4 bytes fills one cache line."""

HUGE_PAGE = 2 << 20
"""Huge page size in bytes on Linux, for x86-64 processors and for arm64 processors with normal pages of 4 KiB."""


def zeros_aligned(shape: tuple[int, ...], dtype: type[Number]) -> NDArray[Number]:
    """Make an array of zeros whose memory address is a multiple of :data:`CACHE_LINE`.

    The alignment prevents false sharing between the threads that draw tiles of 16 x 16 pixels in parallel. NumPy aligns
    images only to 16 bytes. With 4 bytes per pixel, each row of a tile would then share cache lines with the
    neighbouring tiles, and the threads that draw these tiles would slow each other down.

    The memory of an array of at least :data:`HUGE_PAGE` bytes starts and ends at multiples of :data:`HUGE_PAGE`. NumPy
    requests huge pages for large arrays, and with this alignment, Linux can use them for the whole array. Without huge
    pages, the stylizer (:mod:`fourd.rendering.ops.stylize`) takes a third longer, because its filters read several
    image rows at once, each in a different page.
    """
    size = prod(shape) * np.dtype(dtype).itemsize
    alignment = HUGE_PAGE if size >= HUGE_PAGE else CACHE_LINE
    memory = np.zeros(-(-size // alignment) * alignment + alignment, np.uint8)
    first = -memory.ctypes.data % alignment
    return memory[first : first + size].view(dtype).reshape(shape)
