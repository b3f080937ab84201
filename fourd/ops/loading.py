"""The native module, loaded when it is first needed and with its error kept when it cannot be; how it is run."""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType
from typing import Any


def native() -> ModuleType:
    """``fourd._native``. Raises ImportError with the cause and the mend where it does not load."""
    try:
        return import_module("fourd._native")
    except ImportError as cause:
        raise ImportError(
            f"fourd._native: expected the kernels built with this package, got: {cause}; "
            "build them with `pip install .` in the source folder, or use backend='reference'"
        ) from cause


def as_array(tensor: Any) -> Any:
    """A CPU tensor as the dense NumPy array that kernels take; a copy only where it is not contiguous."""
    return tensor.detach().contiguous().numpy()


def thread_count(threads: int, default: int | None = None) -> int:
    """How many threads to use: ``threads`` if above 0, else FOURD_THREADS, else ``default``, else one a core."""
    if threads < 0:
        raise ValueError(f"threads: expected 0 (for the default) or more, got {threads}")
    if threads > 0:
        return threads
    text = os.environ.get("FOURD_THREADS", "")
    if text:
        if not text.isdecimal() or int(text) < 1:
            raise ValueError(f"FOURD_THREADS: expected a whole number of at least 1, got {text!r}")
        return int(text)
    if default is not None:
        return default
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def simd_name() -> str:
    """The instruction set that FOURD_SIMD forces, or '' for the widest there is."""
    return os.environ.get("FOURD_SIMD", "")
