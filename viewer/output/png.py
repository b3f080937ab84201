"""Writes PNG files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.files import write_bytes_atomically


def with_alpha(on_black: NDArray[np.float32], on_white: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return an image (H, W, 4) with straight alpha from two renderings (H, W, 3) in [0, 1] of the same view, in front
    of black and of white. Where nothing was drawn, the two differ by 1, and where the scene is opaque, they are equal.
    """
    # The filter of points can make a pixel brighter than white. The clipped channel then differs less than the others.
    alpha = (1 - (on_white - on_black).max(axis=2, keepdims=True)).clip(0, 1)
    colour = np.divide(on_black, alpha, out=np.zeros_like(on_black), where=alpha > 0)
    return (np.concatenate([colour.clip(0, 1), alpha], axis=2) * 255 + 0.5).astype(np.uint8)


def write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    """Write an image (H, W, 3), or (H, W, 4) with straight alpha, of type uint8 to a file atomically. Raises OSError,
    for example if the disk is full."""
    # cv2.imwrite is not used, because it reports no error when the disk is full.
    order = cv2.COLOR_RGBA2BGRA if rgb.shape[2] == 4 else cv2.COLOR_RGB2BGR
    _, content = cv2.imencode(".png", cv2.cvtColor(rgb, order))
    write_bytes_atomically(path, content.tobytes())
