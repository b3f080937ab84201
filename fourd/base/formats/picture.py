"""Atomic writing of image files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.files import write_bytes_atomically


def write_picture(path: Path, picture: NDArray[np.uint8], flags: Sequence[int] = ()) -> None:
    """Write an image atomically. The suffix of ``path`` selects the format.

    The image is encoded in memory, because cv2.imwrite reports no error when the disk is full.

    Args:
        path: the file, with a suffix such as ``.png``.
        picture: (H, W) grey values, (H, W, 3) BGR or (H, W, 4) BGRA.
        flags: OpenCV's flags for the encoder.

    Raises:
        OSError: if the file cannot be written.
    """
    done, content = cv2.imencode(path.suffix, picture, list(flags))
    if not done:
        raise RuntimeError(f"OpenCV could not encode an image of shape {picture.shape} as {path.suffix}")
    write_bytes_atomically(path, content.tobytes())
