"""Settings of the C library's heap that make it reuse freed memory quickly and keep the process's resident size
bounded. Only glibc is supported. With other C libraries, :func:`retain_freed_memory` and :class:`HeapTrimmer` do
nothing.

Images differ in size, so freed blocks do not always fit the next allocation, and the heap's address space grows for
hours during training. Trimming the heap returns its free pages to the system, so the growing address space occupies
little physical memory. Data that is kept for many steps would fragment the heap, so it is stored in separate pages
outside the heap.
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
"""Target for the resident size of the process, in bytes. The process can exceed it, because memory in use cannot be
returned to the system."""

FULL_RESIDENT_BYTES = 2 * RESIDENT_BYTES
"""Target for the resident size of the process while a full scene is trained, in bytes. It is larger than
RESIDENT_BYTES, the target for object scenes, because a step on a full scene uses more memory. With the smaller target,
the heap would be trimmed in every step."""

MIN_GROWTH_BYTES = 128 * 2**20
"""Minimum growth of the resident size between two trims of the heap, in bytes. If the heap were trimmed more often,
page faults would take most of a step's time."""

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # constants of malloc.h


def retain_freed_memory() -> None:
    """Make the C library keep freed memory in the process until a :class:`HeapTrimmer` returns it to the system.

    By default, the C library returns the memory of a large array to the system as soon as the array is freed. Every
    training step would therefore cause page faults when it allocates large arrays.
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
    """Copy a tensor to memory outside the heap. A tensor on a GPU is returned unchanged."""
    if value.device.type != "cpu":
        return value
    return torch.from_numpy(array_outside_heap(value.numpy()))


class HeapTrimmer:
    """Returns free pages of the heap to the system when the resident size is too large."""

    def __init__(self, resident: int = RESIDENT_BYTES, min_growth: int = MIN_GROWTH_BYTES) -> None:
        """Set the target for the resident size to ``resident`` bytes. After a trim, the heap is trimmed again only when
        the resident size has grown by more than ``min_growth`` bytes."""
        self._malloc_trim = _libc_function("malloc_trim")
        self._resident = resident
        self._min_growth = min_growth
        self._floor = resident_bytes() if self._malloc_trim is not None else 0

    def after_step(self) -> None:
        """Trim the heap if the resident size is too large. The training loop calls this method between steps, when most
        of the heap is free."""
        if self._malloc_trim is None:
            return
        now = resident_bytes()
        self._floor = min(self._floor, now)
        if now > max(self._resident, self._floor + self._min_growth):
            self.trim()

    def trim(self) -> None:
        """Trim the heap unconditionally. The training loop calls this method before checkpoints and validations,
        because they need much memory."""
        if self._malloc_trim is not None:
            self._malloc_trim(ctypes.c_size_t(0))
            self._floor = resident_bytes()


def resident_bytes() -> int:
    """Return the resident size of the process in bytes (Linux only)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def _libc_function(name: str) -> Any:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
