"""Bytes shown in a framebuffer."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.viewer.gl.canvas import Canvas


class Blit:
    """Uploads a picture and copies it into a framebuffer of its size."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._canvas = Canvas(context)

    def draw(self, pixels: NDArray[np.uint8], target: moderngl.Framebuffer) -> None:
        """Show ``pixels`` (H, W, 4), whose row 0 is the top."""
        height, width = pixels.shape[:2]
        source = self._canvas.sized(width, height)
        self._canvas.write(pixels)
        self._context.copy_framebuffer(target, source)
        target.use()

    def release(self) -> None:
        """Give back every GL object."""
        self._canvas.release()
