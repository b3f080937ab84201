"""The framebuffer that renderers draw into."""

from __future__ import annotations

from typing import Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.viewer.gl.passes import release_framebuffer


class Canvas:
    """A framebuffer with one RGBA texture, resized on demand.

    Row 0 of the texture is the bottom of the image, as in OpenGL.
    """

    def __init__(self, context: moderngl.Context, dtype: Literal["f1", "f4"] = "f1") -> None:
        """``dtype`` is "f1" for 8-bit channels, or "f4" for float32. Tests use float32 to measure differences below
        1/255."""
        self._context = context
        self._dtype = dtype
        self._texture: moderngl.Texture | None = None
        self._framebuffer: moderngl.Framebuffer | None = None

    @property
    def size(self) -> tuple[int, int]:
        """The (width, height) of the image in pixels. Before the first image, the size is (0, 0)."""
        return (0, 0) if self._texture is None else self._texture.size

    def framebuffer(self, width: int, height: int) -> moderngl.Framebuffer:
        """Return the framebuffer, resized to ``width`` x ``height`` pixels."""
        if self._framebuffer is None or self.size != (width, height):
            self.release()
            self._texture = self._context.texture((width, height), 4, dtype=self._dtype)
            self._framebuffer = self._context.framebuffer([self._texture])
        return self._framebuffer

    def write(self, pixels: NDArray[np.uint8]) -> None:
        """Upload an image of shape (H, W, 4) and type uint8, with row 0 at the top."""
        height, width = pixels.shape[:2]
        self.framebuffer(width, height)
        assert self._texture is not None
        # The rows are flipped in NumPy. With software OpenGL, a render pass that flips the rows would take four times
        # as long.
        self._texture.write(np.ascontiguousarray(pixels[::-1]))

    def read_rgb8(self) -> NDArray[np.uint8]:
        """Return the image as an array (H, W, 3) of uint8, with row 0 at the top."""
        framebuffer = self.framebuffer(*self.size)
        content = np.frombuffer(framebuffer.read(components=3, alignment=1), np.uint8)
        return np.ascontiguousarray(content.reshape(framebuffer.height, framebuffer.width, 3)[::-1])

    def read_rgba32f(self) -> NDArray[np.float32]:
        """Return the image as an array (H, W, 4) of float32, with row 0 at the top."""
        framebuffer = self.framebuffer(*self.size)
        content = np.frombuffer(framebuffer.read(components=4, dtype="f4"), np.float32)
        return content.reshape(framebuffer.height, framebuffer.width, 4)[::-1]

    def release(self) -> None:
        """Free all GL objects."""
        if self._framebuffer is not None:
            release_framebuffer(self._context, self._framebuffer)
        if self._texture is not None:
            self._texture.release()
        self._framebuffer = self._texture = None
