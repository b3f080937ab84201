"""Arrays of a frame in textures, which a vertex shader reads by index.

Buffer textures would be made for it, but they are the slower path of many drivers, and moderngl has none.
"""

from __future__ import annotations

from typing import Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.baking import BakedFrame
from fourd.baking.attributes import ATTRIBUTES, Attribute
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

    def write(self, array: NDArray[np.generic], first: int = 0) -> None:
        """Take the array's bytes, whole texels, from texel ``first`` on; there must be room for them."""
        content = np.ascontiguousarray(array).reshape(-1, self._components)
        texture, end = self._texture, first + content.shape[0]
        assert texture is not None
        while first < end:
            row, column = divmod(first, TEXELS_A_ROW)
            # Whole rows at once, and before and after them what there is of one.
            whole = 0 if column else (end - first) // TEXELS_A_ROW
            width = TEXELS_A_ROW if whole else min(end - first, TEXELS_A_ROW - column)
            count = width * max(whole, 1)
            texture.write(content[:count], viewport=(column, row, width, max(whole, 1)), alignment=1)
            content, first = content[count:], first + count

    def use(self, location: int) -> None:
        """Bind to a texture unit."""
        assert self._texture is not None
        self._texture.use(location)

    def release(self) -> None:
        if self._texture is not None:
            self._texture.release()
            self._texture = None

    def require_room(self, texels: int) -> bool:
        """Have room for so many texels; whether what it holds is still there. Raises UserError."""
        rows = -(-texels // TEXELS_A_ROW)
        if self._texture is not None and self._texture.height >= rows:
            return True
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
        return False


class UploadedFrame:
    """A frame's arrays where shaders can read them; the textures are used again for the next frame.

    Points that the next frame has too lie behind room for those that it has not, and stay.
    """

    def __init__(self, context: moderngl.Context, precision: Precision) -> None:
        """float32 takes twice the memory and bandwidth, and is there to be compared with."""
        short = "f2" if precision == "float16" else "f4"
        self._number = np.float16 if precision == "float16" else np.float32
        formats = {"<f4": "f4", "<f2": short, "|u1": "f1"}
        self._textures = {
            item.name: ArrayTexture(context, _components(item), formats[item.dtype]) for item in ATTRIBUTES
        }
        self.frame: BakedFrame | None = None
        self._background: BakedFrame | None = None
        self._has_shadow = False
        self._room = 0  # points before the still ones

    def load(self, frame: BakedFrame) -> None:
        """Upload unless it is there already."""
        if frame is self.frame:
            return
        self.frame = None  # not half of one, should a write fail
        kept = self._make_room(frame)
        recoloured = frame.has_shadow or self._has_shadow
        self._background = None
        for attribute in frame.attributes:
            self._write(attribute, frame, slice(0, frame.dynamic_count), 0)
            if frame.background is not None and (not kept or (attribute.combine == "cast_shadow" and recoloured)):
                self._write(attribute, frame, slice(frame.dynamic_count, None), self._room)
        self._background, self._has_shadow = frame.background, frame.has_shadow
        self.frame = frame

    def use(self) -> dict[str, int]:
        """Bind all textures; returns what the shader is told: the unit of each by name, and where points lie."""
        assert self.frame is not None
        names = [attribute.name for attribute in self.frame.attributes]
        for unit, name in enumerate(names):
            self._textures[name].use(unit)
        moving = self.frame.dynamic_count
        gap = 0 if self.frame.background is None else self._room - moving
        return {"moving": moving, "gap": gap, **{name: unit for unit, name in enumerate(names)}}

    def release(self) -> None:
        for texture in self._textures.values():
            texture.release()
        self.frame = self._background = None

    def _make_room(self, frame: BakedFrame) -> bool:
        """Have room for all points; whether the still ones are there already."""
        same = frame.background is not None and frame.background is self._background
        kept = same and frame.dynamic_count <= self._room
        if not kept:
            # Frames differ in their points by a few: the largest need not come first.
            self._room = frame.dynamic_count if frame.background is None else int(1.25 * frame.dynamic_count)
        behind = 0 if frame.background is None else frame.background.point_count
        for attribute in frame.attributes:
            texels = (self._room + behind) * _texels(attribute, frame)
            kept &= self._textures[attribute.name].require_room(texels)
        return kept

    def _write(self, attribute: Attribute, frame: BakedFrame, points: slice, first: int) -> None:
        array = getattr(frame, attribute.name)[points]
        if array.dtype == np.float16:
            array = array.astype(self._number, copy=False)
        self._textures[attribute.name].write(array, first * _texels(attribute, frame))


def _components(attribute: Attribute) -> int:
    """Numbers per texel: as many as fit a point's numbers evenly, at most four."""
    return next(count for count in (4, 3, 2, 1) if attribute.numbers % count == 0)


def _texels(attribute: Attribute, frame: BakedFrame) -> int:
    """Texels per point."""
    views = frame.view_count if attribute.is_per_view else 1
    return attribute.numbers // _components(attribute) * views
