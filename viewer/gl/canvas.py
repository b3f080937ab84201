"""Where pictures are drawn before they are shown or saved."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.viewer.gl.pictures import release_framebuffer


class Canvas:
    """A framebuffer of bytes whose size follows the shots."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._texture: moderngl.Texture | None = None
        self._framebuffer: moderngl.Framebuffer | None = None

    def sized(self, width: int, height: int) -> moderngl.Framebuffer:
        """The framebuffer, of this size."""
        if self._framebuffer is None or self._framebuffer.size != (width, height):
            self.release()
            self._texture = self._context.texture((width, height), 4)
            self._framebuffer = self._context.framebuffer([self._texture])
        return self._framebuffer

    def write(self, pixels: NDArray[np.uint8]) -> None:
        """Replace the picture by ``pixels`` (H, W, 4) of its size, row 0 at the top."""
        assert self._texture is not None
        # Turned here and not by a pass over all pixels, which takes four times as long where GL is software.
        self._texture.write(np.ascontiguousarray(pixels[::-1]))

    def pixels(self) -> NDArray[np.uint8]:
        """(H, W, 3) of what was drawn, row 0 at the top."""
        assert self._framebuffer is not None
        width, height = self._framebuffer.size
        content = np.frombuffer(self._framebuffer.read(components=3, alignment=1), np.uint8)
        return np.ascontiguousarray(content.reshape(height, width, 3)[::-1])

    def release(self) -> None:
        """Give back every GL object."""
        if self._framebuffer is not None:
            release_framebuffer(self._context, self._framebuffer)
        if self._texture is not None:
            self._texture.release()
        self._framebuffer = self._texture = None
