"""Captures (multi-view videos on disk): layout of the folder, calibration files, reading on demand, and checks.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.recording.capture.calibration import read_calibration, write_calibration
    from fourd.recording.capture.reader import Capture, open_capture

_MODULES: dict[str, str] = {
    "Capture": "reader",
    "open_capture": "reader",
    "read_calibration": "calibration",
    "write_calibration": "calibration",
}
"""Maps each public name to the module of this package that defines it."""

__all__ = ["Capture", "open_capture", "read_calibration", "write_calibration"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
