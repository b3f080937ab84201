"""Captures (multi-view videos on disk): layout of the folder, calibration files, reading on demand, and checks."""

from fourd.recording.capture.calibration import read_calibration, write_calibration
from fourd.recording.capture.reader import Capture, open_capture

__all__ = ["Capture", "open_capture", "read_calibration", "write_calibration"]
