"""Control of the C library's heap (glibc; a no-op elsewhere): fast reuse within a bounded resident size.

Images differ in size, so freed memory does not always fit the next allocation, and the heap's address space grows for
hours. Only pages that were touched since the last trim occupy memory. Data that stays alive for many steps is stored
outside the heap, in pages of its own, because it would fragment the heap.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

RESIDENT_BYTES = 1000 * 2**20
"""Target for the process's resident size. Live data cannot be returned, so it is no hard limit."""

FULL_RESIDENT_BYTES = 2 * RESIDENT_BYTES
"""The same for a full scene, where each step would start with unmapped memory at the smaller target."""

MIN_GROWTH_BYTES = 128 * 2**20
"""Growth between two trims: with less, every step would spend its time in page faults."""

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # of malloc.h


def retain_freed_memory() -> None:
    """Keep freed memory in the process until a :class:`HeapTrimmer` returns it to the system.

    By default the C library returns every large array at once, and each step spends time in page faults.
    """
    mallopt = _libc_function("mallopt")
    if mallopt is not None:
        mallopt(ctypes.c_int(_MMAP_MAX), ctypes.c_int(0))
        mallopt(ctypes.c_int(_TRIM_THRESHOLD), ctypes.c_int(2**31 - 1))


def array_outside_heap(array: NDArray[Any]) -> NDArray[Any]:
    """A writable copy outside the heap; its pages return to the system with its last view."""
    pages = mmap.mmap(-1, max(array.nbytes, 1))
    copy = np.frombuffer(pages, array.dtype, count=array.size).reshape(array.shape)
    copy[...] = array
    return copy


def tensor_outside_heap(value: Tensor) -> Tensor:
    """The same of a CPU tensor."""
    return torch.from_numpy(array_outside_heap(value.numpy()))


class HeapTrimmer:
    """Returns the heap's free pages to the system before the process holds too much."""

    def __init__(self, resident: int = RESIDENT_BYTES, min_growth: int = MIN_GROWTH_BYTES) -> None:
        """Target ``resident`` bytes; at least ``min_growth`` bytes are touched between two trims."""
        self._malloc_trim = _libc_function("malloc_trim")
        self._resident = resident
        self._min_growth = min_growth
        self._floor = resident_bytes() if self._malloc_trim is not None else 0

    def after_step(self) -> None:
        """Trim if the process holds too much. Called between steps, when most memory is free."""
        if self._malloc_trim is None:
            return
        now = resident_bytes()
        self._floor = min(self._floor, now)
        if now > max(self._resident, self._floor + self._min_growth):
            self.trim()

    def trim(self) -> None:
        """Trim at once, before rare work that needs much memory."""
        if self._malloc_trim is not None:
            self._malloc_trim(ctypes.c_size_t(0))
            self._floor = resident_bytes()


def resident_bytes() -> int:
    """Resident size of the process in bytes (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def _libc_function(name: str) -> Any:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
