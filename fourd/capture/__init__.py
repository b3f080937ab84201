"""Multi-view video on disk: layout, calibration files, lazy reading, checks."""

from fourd.capture.calibration import read_calibration, write_calibration
from fourd.capture.reader import Capture, open_capture

__all__ = ["Capture", "open_capture", "read_calibration", "write_calibration"]
