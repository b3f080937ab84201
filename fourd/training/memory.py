"""Control of the C library's heap: fast reuse of freed memory within a bounded resident size. Only glibc is supported;
with other libraries the functions do nothing.

Images differ in size, so freed memory does not always fit the next allocation, and the heap's address space grows for
hours. Of this address space, only pages that were written since the last trim occupy memory. Data that stays alive for
many steps would fragment the heap. Such data is stored outside the heap, in separate pages.
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
"""Target for the process's resident size. The target can be exceeded, because memory in use cannot be returned to the
system."""

FULL_RESIDENT_BYTES = 2 * RESIDENT_BYTES
"""Target for a full scene, whose steps use more memory. With the smaller target, the heap would be trimmed at every
step."""

MIN_GROWTH_BYTES = 128 * 2**20
"""Minimum growth of the resident size between two trims. With more frequent trims, page faults would dominate every
step's time."""

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # constants of malloc.h


def retain_freed_memory() -> None:
    """Keep freed memory in the process until a :class:`HeapTrimmer` returns it to the system.

    By default, the C library returns the memory of a large array as soon as it is freed. Each step would then spend
    time in page faults.
    """
    mallopt = _libc_function("mallopt")
    if mallopt is not None:
        mallopt(ctypes.c_int(_MMAP_MAX), ctypes.c_int(0))
        mallopt(ctypes.c_int(_TRIM_THRESHOLD), ctypes.c_int(2**31 - 1))


def array_outside_heap(array: NDArray[Any]) -> NDArray[Any]:
    """Copy an array to writable memory outside the heap. The memory is returned to the system when the last view of the
    copy is deleted."""
    pages = mmap.mmap(-1, max(array.nbytes, 1))
    copy = np.frombuffer(pages, array.dtype, count=array.size).reshape(array.shape)
    copy[...] = array
    return copy


def tensor_outside_heap(value: Tensor) -> Tensor:
    """Copy a CPU tensor to memory outside the heap."""
    return torch.from_numpy(array_outside_heap(value.numpy()))


class HeapTrimmer:
    """Returns free pages of the heap to the system when the resident size is too large."""

    def __init__(self, resident: int = RESIDENT_BYTES, min_growth: int = MIN_GROWTH_BYTES) -> None:
        """Set the target to ``resident`` bytes. After a trim, the next trim follows only when the resident size has
        grown by more than ``min_growth`` bytes."""
        self._malloc_trim = _libc_function("malloc_trim")
        self._resident = resident
        self._min_growth = min_growth
        self._floor = resident_bytes() if self._malloc_trim is not None else 0

    def after_step(self) -> None:
        """Trim if the resident size is too large. Called between steps, when most of the heap is free."""
        if self._malloc_trim is None:
            return
        now = resident_bytes()
        self._floor = min(self._floor, now)
        if now > max(self._resident, self._floor + self._min_growth):
            self.trim()

    def trim(self) -> None:
        """Trim unconditionally, before rare work that needs much memory."""
        if self._malloc_trim is not None:
            self._malloc_trim(ctypes.c_size_t(0))
            self._floor = resident_bytes()


def resident_bytes() -> int:
    """Resident size of the process in bytes (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def _libc_function(name: str) -> Any:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
