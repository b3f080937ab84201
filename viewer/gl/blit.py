"""Bytes shown in a framebuffer."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.viewer.gl.pictures import release_framebuffer


class Blit:
    """Uploads a picture and copies it into a framebuffer of its size."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._texture: moderngl.Texture | None = None
        self._framebuffer: moderngl.Framebuffer | None = None

    def draw(self, pixels: NDArray[np.uint8], target: moderngl.Framebuffer) -> None:
        """Show ``pixels`` (H, W, 4), whose row 0 is the top."""
        height, width = pixels.shape[:2]
        if self._texture is None or self._framebuffer is None or self._texture.size != (width, height):
            self.release()
            self._texture = self._context.texture((width, height), 4)
            self._framebuffer = self._context.framebuffer([self._texture])
        # Turned here and not by a pass over all pixels, which takes four times as long where GL is software.
        self._texture.write(np.ascontiguousarray(pixels[::-1]))
        self._context.copy_framebuffer(target, self._framebuffer)
        target.use()

    def release(self) -> None:
        """Give back every GL object."""
        if self._framebuffer is not None:
            release_framebuffer(self._context, self._framebuffer)
        if self._texture is not None:
            self._texture.release()
        self._framebuffer = self._texture = None
