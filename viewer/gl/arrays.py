"""Arrays of a frame in textures, which a vertex shader reads by index.

Buffer textures would be made for it, but they are the slower path of many drivers, and moderngl has none.
"""

from __future__ import annotations

from typing import Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.baking import BakedFrame
from fourd.errors import UserError
from fourd.viewer.gl.context import information
from fourd.viewer.gl.shaders import TEXELS_A_ROW

Precision = Literal["float16", "float32"]


class ArrayTexture:
    """A row-major array as texels; its storage is kept and grows when a larger array comes."""

    def __init__(self, context: moderngl.Context, components: int, dtype: str) -> None:
        """``components`` numbers a texel; ``dtype`` as moderngl has it: f1 (bytes as [0, 1]), f2 or f4."""
        self._context = context
        self._components = components
        self._dtype = dtype
        self._texture: moderngl.Texture | None = None

    def write(self, array: NDArray[np.generic]) -> None:
        """Take the array's bytes, which must be whole texels. Raises UserError when they do not fit a texture."""
        content = np.ascontiguousarray(array).reshape(-1, self._components)
        texture = self.require_room(content.shape[0])
        whole, rest = divmod(content.shape[0], TEXELS_A_ROW)
        if whole:
            texture.write(content[: whole * TEXELS_A_ROW], viewport=(0, 0, TEXELS_A_ROW, whole), alignment=1)
        if rest:
            texture.write(content[whole * TEXELS_A_ROW :], viewport=(0, whole, rest, 1), alignment=1)

    def use(self, location: int) -> None:
        """Bind to a texture unit."""
        assert self._texture is not None
        self._texture.use(location)

    def release(self) -> None:
        if self._texture is not None:
            self._texture.release()
            self._texture = None

    def require_room(self, texels: int) -> moderngl.Texture:
        """The texture, of so many texels at least; what it held is lost when it grows. Raises UserError."""
        rows = -(-texels // TEXELS_A_ROW)
        if self._texture is not None and self._texture.height >= rows:
            return self._texture
        most = information(self._context)["GL_MAX_TEXTURE_SIZE"]
        if most < TEXELS_A_ROW or rows > most:
            raise UserError(
                f"OpenGL: expected textures of {TEXELS_A_ROW} x {rows} texels for this scene, got a driver with "
                f"{most} x {most}; add --renderer cpu"
            )
        self.release()
        size = (TEXELS_A_ROW, max(rows, 1))
        self._texture = self._context.texture(size, self._components, dtype=self._dtype, alignment=1)
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return self._texture


class UploadedFrame:
    """A frame's arrays where shaders can read them; the textures are used again for the next frame."""

    def __init__(self, context: moderngl.Context, precision: Precision) -> None:
        """float32 takes twice the memory and bandwidth, and is there to be compared with."""
        short = "f2" if precision == "float16" else "f4"
        self._number = np.float16 if precision == "float16" else np.float32
        self._textures = {
            "xyz": ArrayTexture(context, 3, "f4"),
            "radius": ArrayTexture(context, 1, short),
            "density": ArrayTexture(context, 1, short),
            "sh": ArrayTexture(context, 4, short),
            "blend_weights": ArrayTexture(context, 1, short),
            "rgb": ArrayTexture(context, 3, "f1"),
        }
        self.frame: BakedFrame | None = None

    def load(self, frame: BakedFrame) -> None:
        """Upload unless it is there already."""
        if frame is self.frame:
            return
        self.frame = None  # not half of one, should a write fail
        self._textures["xyz"].write(frame.xyz)
        for name in ("radius", "density", "sh", "blend_weights"):
            self._textures[name].write(getattr(frame, name).astype(self._number, copy=False))
        self._textures["rgb"].write(frame.rgb)
        self.frame = frame

    def use(self) -> dict[str, int]:
        """Bind all textures; returns the unit of each by name."""
        for unit, texture in enumerate(self._textures.values()):
            texture.use(unit)
        return {name: unit for unit, name in enumerate(self._textures)}

    def release(self) -> None:
        for texture in self._textures.values():
            texture.release()
        self.frame = None
