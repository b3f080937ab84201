"""The C library's heap (glibc's; elsewhere nothing is done): quick to reuse, and yet small.

Pictures differ in size, so freed memory does not always fit what is asked for next: the heap's address
space grows for hours. Only the pages of it that were touched since the last trim cost memory.
"""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path
from typing import Any

RESIDENT_BYTES = 1100 * 2**20
"""What a process may hold before its heap is trimmed: an aim, for what is alive cannot be given back."""

GROWTH_BYTES = 256 * 2**20
"""Between two trims at least: with less, every step would pay for the page faults of fresh memory."""

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # of malloc.h


def keep_freed_memory() -> None:
    """Let the process keep what it frees until a :class:`HeapTrimmer` gives it back.

    Large arrays would go back to the system one by one otherwise, and every step would pay for the
    page faults of fresh ones.
    """
    mallopt = _function("mallopt")
    if mallopt is not None:
        mallopt(ctypes.c_int(_MMAP_MAX), ctypes.c_int(0))
        mallopt(ctypes.c_int(_TRIM_THRESHOLD), ctypes.c_int(2**31 - 1))


class HeapTrimmer:
    """Gives the heap's free pages back whenever the process holds too much."""

    def __init__(self, resident: int = RESIDENT_BYTES, growth: int = GROWTH_BYTES) -> None:
        """Aim at ``resident`` bytes, but let ``growth`` bytes be touched between two trims."""
        self._malloc_trim = _function("malloc_trim")
        self._resident = resident
        self._growth = growth
        self._floor = 0

    def trim_if_large(self) -> None:
        """To be called after every step."""
        if self._malloc_trim is None:
            return
        resident = resident_bytes()
        if resident > max(self._resident, self._floor + self._growth):
            self.trim()
        else:
            self._floor = min(self._floor, resident)

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
