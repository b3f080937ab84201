"""The C library's heap (glibc's; elsewhere nothing is done): quick to reuse, and yet small.

Pictures differ in size, so freed memory does not always fit what is asked for next.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Any

TRIM_EVERY = 20
"""Steps; more seldom lets the heap grow by hundreds of MB, more often costs page faults."""

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # of malloc.h


def keep_freed_memory() -> None:
    """Let the process keep what it frees until :func:`release_freed_memory`.

    Large arrays would go back to the system one by one otherwise, and every step would pay for the
    page faults of fresh ones.
    """
    mallopt = _function("mallopt")
    if mallopt is not None:
        mallopt(ctypes.c_int(_MMAP_MAX), ctypes.c_int(0))
        mallopt(ctypes.c_int(_TRIM_THRESHOLD), ctypes.c_int(2**31 - 1))


def release_freed_memory() -> None:
    """Give the heap's free pages back to the system."""
    trim = _function("malloc_trim")
    if trim is not None:
        trim(ctypes.c_size_t(0))


def _function(name: str) -> Any:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
