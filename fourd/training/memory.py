"""The C library's heap (glibc's; elsewhere nothing is done to it): quick to reuse, and yet small.

Pictures differ in size, so freed memory does not always fit what is asked for next: the heap's address
space grows for hours. Only the pages of it that were touched since the last trim cost memory. What lives
for many steps stays out of it, in pages of its own: it would pin and split what lies around it.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

RESIDENT_BYTES = 1000 * 2**20
"""What a process may hold: an aim, for what is alive cannot be given back."""

FULL_RESIDENT_BYTES = 2 * RESIDENT_BYTES
"""The same for a full scene, whose steps would begin with fresh memory else, every one of them."""

MIN_GROWTH_BYTES = 128 * 2**20
"""Between two trims: with less, every step would pay for the page faults of fresh memory."""

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # of malloc.h


def retain_freed_memory() -> None:
    """Let the process keep what it frees until a :class:`HeapTrimmer` gives it back.

    Large arrays would go back to the system one by one otherwise, and every step would pay for the
    page faults of fresh ones.
    """
    mallopt = _function("mallopt")
    if mallopt is not None:
        mallopt(ctypes.c_int(_MMAP_MAX), ctypes.c_int(0))
        mallopt(ctypes.c_int(_TRIM_THRESHOLD), ctypes.c_int(2**31 - 1))


def in_own_pages(array: NDArray[Any]) -> NDArray[Any]:
    """A writable copy outside the heap; its pages go back to the system with its last view."""
    pages = mmap.mmap(-1, max(array.nbytes, 1))
    copy = np.frombuffer(pages, array.dtype, count=array.size).reshape(array.shape)
    copy[...] = array
    return copy


class HeapTrimmer:
    """Gives the heap's free pages back before the process holds too much."""

    def __init__(self, resident: int = RESIDENT_BYTES, least_growth: int = MIN_GROWTH_BYTES) -> None:
        """Aim at ``resident`` bytes, but let ``least_growth`` bytes be touched between two trims."""
        self._malloc_trim = _function("malloc_trim")
        self._resident = resident
        self._least_growth = least_growth
        self._floor = resident_bytes() if self._malloc_trim is not None else 0

    def after_step(self) -> None:
        """Trim if the process holds too much: the next step finds room in what this one has freed."""
        if self._malloc_trim is None:
            return
        now = resident_bytes()
        self._floor = min(self._floor, now)
        if now > max(self._resident, self._floor + self._least_growth):
            self.trim()

    def trim(self) -> None:
        """To be called before what is seldom done and takes much memory."""
        if self._malloc_trim is not None:
            self._malloc_trim(ctypes.c_size_t(0))
            self._floor = resident_bytes()


def resident_bytes() -> int:
    """Of the machine's memory, what the process holds now (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def _function(name: str) -> Any:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
