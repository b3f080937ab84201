"""The native module, loaded when it is first needed and with its error kept when it cannot be."""

from __future__ import annotations

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
