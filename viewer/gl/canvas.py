"""Where pictures are drawn before they are shown or saved."""

from __future__ import annotations

from typing import Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.viewer.gl.pictures import release_framebuffer


class Canvas:
    """A framebuffer whose size follows what is drawn; its first row of pixels is the lowest, as GL has it."""

    def __init__(self, context: moderngl.Context, dtype: Literal["f1", "f4"] = "f1") -> None:
        """Of bytes, or of float32 for tests of what bytes would hide."""
        self._context = context
        self._dtype = dtype
        self._texture: moderngl.Texture | None = None
        self._framebuffer: moderngl.Framebuffer | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of what was drawn last; (0, 0) before that."""
        return (0, 0) if self._texture is None else self._texture.size

    def sized(self, width: int, height: int) -> moderngl.Framebuffer:
        """The framebuffer, of this size."""
        if self._framebuffer is None or self.size != (width, height):
            self.release()
            self._texture = self._context.texture((width, height), 4, dtype=self._dtype)
            self._framebuffer = self._context.framebuffer([self._texture])
        return self._framebuffer

    def write(self, pixels: NDArray[np.uint8]) -> None:
        """Take a picture (H, W, 4) of bytes, row 0 at the top."""
        height, width = pixels.shape[:2]
        self.sized(width, height)
        assert self._texture is not None
        # Turned here and not by a pass over all pixels, which takes four times as long where GL is software.
        self._texture.write(np.ascontiguousarray(pixels[::-1]))

    def pixels(self) -> NDArray[np.uint8]:
        """(H, W, 3) bytes of what was drawn, row 0 at the top."""
        framebuffer = self.sized(*self.size)
        content = np.frombuffer(framebuffer.read(components=3, alignment=1), np.uint8)
        return np.ascontiguousarray(content.reshape(framebuffer.height, framebuffer.width, 3)[::-1])

    def numbers(self) -> NDArray[np.float32]:
        """(H, W, 4) of what was drawn, row 0 at the top."""
        framebuffer = self.sized(*self.size)
        content = np.frombuffer(framebuffer.read(components=4, dtype="f4"), np.float32)
        return content.reshape(framebuffer.height, framebuffer.width, 4)[::-1]

    def release(self) -> None:
        """Give back every GL object."""
        if self._framebuffer is not None:
            release_framebuffer(self._context, self._framebuffer)
        if self._texture is not None:
            self._texture.release()
        self._framebuffer = self._texture = None
