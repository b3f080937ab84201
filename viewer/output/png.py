"""Writes PNG files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.files import write_bytes_atomically


def write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    """Write an image (H, W, 3) of type uint8 to a file atomically. Raises OSError, for example if the disk is full."""
    # cv2.imwrite is not used, because it reports no error when the disk is full.
    _, content = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    write_bytes_atomically(path, content.tobytes())
