"""Loads the native module, and selects the number of threads and the instruction set of its kernels."""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

TYPE_CODES = {"torch.float32": "=f4", "torch.int64": "=i8"}
"""Name of a dtype in torch -> its code in NumPy, for tensors that :func:`as_array` converts without torch operators."""


def load_native() -> ModuleType:
    """Import and return ``fourd._native``.

    Raises:
        ImportError: if the module cannot be loaded. The error message names the cause and the fix.
    """
    try:
        return import_module("fourd._native")
    except ImportError as cause:
        raise ImportError(
            f"fourd._native: expected the kernels built with this package, got: {cause}; "
            "build them with `pip install .` in the source folder, or use backend='reference'"
        ) from cause


class _Memory:
    """The memory of a contiguous CPU tensor, for ``numpy.asarray``."""

    __slots__ = ("__array_interface__", "tensor")

    def __init__(self, tensor: Any, type_code: str) -> None:
        self.tensor = tensor  # Keeps the memory.
        self.__array_interface__ = {
            "shape": tuple(tensor.shape),
            "typestr": type_code,
            "data": (tensor.data_ptr(), False),
            "version": 3,
        }


def as_array(tensor: Any) -> Any:
    """Return a CPU tensor as a contiguous NumPy array, copied only if the tensor is not contiguous.

    ``Tensor.numpy`` calls four torch operators for each of the 160 arrays that a training step passes to kernels.
    Tensors of common dtypes therefore pass their address to NumPy.
    """
    if not tensor.is_contiguous():
        tensor = tensor.detach().contiguous()
    code = TYPE_CODES.get(str(tensor.dtype))
    if code is None or not tensor.is_cpu or tensor.numel() == 0:
        return tensor.detach().numpy()
    return np.asarray(_Memory(tensor, code))


def thread_count(threads: int, default: int | None = None) -> int:
    """Return the number of threads that a kernel uses.

    A positive ``threads`` has priority, then the environment variable FOURD_THREADS, then ``default``, then the number
    of available cores.

    Raises:
        ValueError: for a negative ``threads`` or an invalid FOURD_THREADS.
    """
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
    """Return the instruction set that the environment variable FOURD_SIMD selects, or '' for the widest available
    one."""
    return os.environ.get("FOURD_SIMD", "")
