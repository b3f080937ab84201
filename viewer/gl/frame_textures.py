"""Stores the arrays of a frame in textures that vertex shaders read by index.

OpenGL's buffer textures are not used, because moderngl does not support them and many drivers read them more slowly
than other textures.
"""

from __future__ import annotations

from typing import Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.scene import BakedFrame
from fourd.scene.attributes import ATTRIBUTES, Attribute
from fourd.viewer.gl.context import driver_info
from fourd.viewer.gl.shaders import TEXELS_PER_ROW

Precision = Literal["float16", "float32"]


class ArrayTexture:
    """A texture that stores a row-major array.

    Later arrays reuse the storage of the texture, which grows if an array needs more space.
    """

    def __init__(self, context: moderngl.Context, components: int, dtype: str) -> None:
        """``components`` is the number of values per texel.

        ``dtype`` is a moderngl format: f1 (bytes that shaders read as numbers in [0, 1]), f2 (float16) or f4 (float32).
        """
        self._context = context
        self._components = components
        self._dtype = dtype
        self._texture: moderngl.Texture | None = None

    def write(self, array: NDArray[np.generic], first: int = 0) -> None:
        """Upload an array of whole texels, starting at texel ``first``.

        The caller must have reserved the texels with :meth:`reserve`.
        """
        content = np.ascontiguousarray(array).reshape(-1, self._components)
        texture, end = self._texture, first + content.shape[0]
        assert texture is not None
        while first < end:
            row, column = divmod(first, TEXELS_PER_ROW)
            # All complete rows are uploaded in one call. An incomplete row before or after the complete rows is
            # uploaded separately.
            full_rows = 0 if column else (end - first) // TEXELS_PER_ROW
            width = TEXELS_PER_ROW if full_rows else min(end - first, TEXELS_PER_ROW - column)
            count = width * max(full_rows, 1)
            texture.write(content[:count], viewport=(column, row, width, max(full_rows, 1)), alignment=1)
            content, first = content[count:], first + count

    def use(self, location: int) -> None:
        """Bind the texture to texture unit ``location``."""
        assert self._texture is not None
        self._texture.use(location)

    def release(self) -> None:
        """Free the texture."""
        if self._texture is not None:
            self._texture.release()
            self._texture = None

    def reserve(self, texels: int) -> bool:
        """Reserve storage for ``texels`` texels.

        Returns True if the texture keeps its content, or False if it had to be enlarged, which loses the content.
        Raises UserError if the texture would exceed the driver's limit.
        """
        rows = -(-texels // TEXELS_PER_ROW)
        if self._texture is not None and self._texture.height >= rows:
            return True
        max_side = driver_info(self._context)["GL_MAX_TEXTURE_SIZE"]
        if max_side < TEXELS_PER_ROW or rows > max_side:
            raise UserError(
                f"OpenGL: expected textures of {TEXELS_PER_ROW} x {rows} texels for this scene, got a driver with "
                f"{max_side} x {max_side}; add --renderer cpu"
            )
        self.release()
        size = (TEXELS_PER_ROW, max(rows, 1))
        self._texture = self._context.texture(size, self._components, dtype=self._dtype, alignment=1)
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return False


class FrameTextures:
    """The arrays of one frame in GPU textures. The next frame reuses the textures.

    Each texture stores the frame's own points (the dynamic points) first, then unused texels, then the points of the
    background. A background that consecutive frames share is uploaded once. The colours of the background are uploaded
    again only if the new frame or the previous frame has a shadow on the background.
    """

    def __init__(self, context: moderngl.Context, precision: Precision) -> None:
        """``precision`` is the texel type of the textures that store a frame's float16 arrays.

        Tests and benchmarks use float32 as the reference. It needs twice the memory and bandwidth of float16.
        """
        short = "f2" if precision == "float16" else "f4"
        self._float16_dtype = np.float16 if precision == "float16" else np.float32
        formats = {"<f4": "f4", "<f2": short, "|u1": "f1"}
        self._textures = {
            attribute.name: ArrayTexture(context, _components(attribute), formats[attribute.dtype])
            for attribute in ATTRIBUTES
        }
        self.frame: BakedFrame | None = None
        self._background: BakedFrame | None = None
        self._has_shadow = False
        self._dynamic_capacity = 0  # number of dynamic points that fit before the background's points

    def load(self, frame: BakedFrame) -> None:
        """Upload ``frame``, unless it is already loaded."""
        if frame is self.frame:
            return
        self.frame = None  # if the upload fails, no frame counts as loaded
        keeps_background = self._reserve(frame)
        changes_shadow = frame.has_shadow or self._has_shadow
        self._background = None
        for attribute in frame.attributes:
            self._write(attribute, frame, slice(0, frame.dynamic_count), 0)
            changes_values = attribute.combine == "cast_shadow" and changes_shadow
            if frame.background is not None and (not keeps_background or changes_values):
                self._write(attribute, frame, slice(frame.dynamic_count, None), self._dynamic_capacity)
        self._background, self._has_shadow = frame.background, frame.has_shadow
        self.frame = frame

    def use(self) -> dict[str, int]:
        """Bind all textures.

        Returns the uniforms of shade.vert: the texture unit of each array by name, and the layout of the points.
        """
        assert self.frame is not None
        names = [attribute.name for attribute in self.frame.attributes]
        for unit, name in enumerate(names):
            self._textures[name].use(unit)
        dynamic_count = self.frame.dynamic_count
        gap = 0 if self.frame.background is None else self._dynamic_capacity - dynamic_count
        return {"dynamic_count": dynamic_count, "gap": gap, **{name: unit for unit, name in enumerate(names)}}

    def release(self) -> None:
        """Free all textures."""
        for texture in self._textures.values():
            texture.release()
        self.frame = self._background = None

    def _reserve(self, frame: BakedFrame) -> bool:
        """Reserve storage for all points of ``frame``.

        Returns True if the textures already contain the frame's background.
        """
        is_same = frame.background is not None and frame.background is self._background
        keeps_background = is_same and frame.dynamic_count <= self._dynamic_capacity
        if not keeps_background:
            # The extra 25% avoids another allocation when a later frame has slightly more points.
            headroom = 1.0 if frame.background is None else 1.25
            self._dynamic_capacity = int(headroom * frame.dynamic_count)
        background_count = 0 if frame.background is None else frame.background.point_count
        for attribute in frame.attributes:
            texels = (self._dynamic_capacity + background_count) * _texels_per_point(attribute, frame)
            keeps_background &= self._textures[attribute.name].reserve(texels)
        return keeps_background

    def _write(self, attribute: Attribute, frame: BakedFrame, points: slice, first_point: int) -> None:
        array = getattr(frame, attribute.name)[points]
        if array.dtype == np.float16:
            array = array.astype(self._float16_dtype, copy=False)
        self._textures[attribute.name].write(array, first_point * _texels_per_point(attribute, frame))


def _components(attribute: Attribute) -> int:
    """Return the number of values per texel, which is the largest number up to 4 that divides the number of values per
    point."""
    return next(count for count in (4, 3, 2, 1) if attribute.numbers % count == 0)


def _texels_per_point(attribute: Attribute, frame: BakedFrame) -> int:
    views = frame.view_count if attribute.is_per_view else 1
    return attribute.numbers // _components(attribute) * views
