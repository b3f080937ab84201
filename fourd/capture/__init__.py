"""Captures, which are multi-view videos on disk: their layout, calibration files, lazy reading and checks."""

from fourd.capture.calibration import read_calibration, write_calibration
from fourd.capture.reader import Capture, open_capture

__all__ = ["Capture", "open_capture", "read_calibration", "write_calibration"]
