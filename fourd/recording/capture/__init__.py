"""Captures (multi-view videos on disk): layout of the folder, calibration files, reading on demand, and checks.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.recording.capture.calibration import read_calibration, write_calibration
    from fourd.recording.capture.reader import Capture, open_capture

__all__ = ["Capture", "open_capture", "read_calibration", "write_calibration"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Capture": "reader",
        "open_capture": "reader",
        "read_calibration": "calibration",
        "write_calibration": "calibration",
    },
)
