"""Keeping the process small: pictures differ in size, so freed memory does not fit what is asked for next."""

from __future__ import annotations

import ctypes
import sys

TRIM_EVERY = 20
"""Steps; more seldom lets the heap grow by hundreds of MB, more often costs page faults."""


def release_freed_memory() -> None:
    """Give the heap's free pages back to the system, where the C library can (glibc)."""
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(ctypes.c_size_t(0))
