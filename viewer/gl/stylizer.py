"""Stylizes images in OpenGL, with the formulas of :mod:`fourd.rendering.ops.stylize.parameters` as fragment passes."""

from __future__ import annotations

from dataclasses import dataclass, fields

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.stylize.parameters import DETAILS, LINE_FILTERS, TONES, StyleParameters, speck_reach
from fourd.rendering.ops.stylize.reference import remove_specks
from fourd.viewer.gl.passes import FullScreenPass, RenderTargets, disable_blending


@dataclass(frozen=True, eq=False)
class SurfaceTextures:
    """Textures of a visible surface, with the layout of :class:`fourd.rendering.ops.stylize.parameters.Surface`. Row 0
    of a texture is the top of the image."""

    albedo: moderngl.Texture
    inverse_depth: moderngl.Texture
    normal: moderngl.Texture


class GLStylizer:
    """Draws surfaces in a style, and keeps the lines of the last image, on which the lines of the next image depend."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        formats = {"depth": (1, "f4"), "normal": (4, "f1"), "shaded": (4, "f1"), "picture": (4, "f1")}
        self._targets = RenderTargets(context, {**formats, "lines 0": (1, "u4"), "lines 1": (1, "u4")})
        self._close = FullScreenPass(context, "stylize/gaps.frag.js")
        self._shade = FullScreenPass(context, "stylize/picture.frag")
        self._draw_lines = FullScreenPass(context, "stylize/outlines.frag.js")
        self._table: moderngl.Texture | None = None
        self._table_source: NDArray[np.uint8] | None = None
        self._last = 0
        self._thickness = 1
        self._has_state = False

    @property
    def line_strength(self) -> NDArray[np.uint8]:
        """Strength of the lines in the last image, as an array (H, W). Specks (very short lines) are removed, because
        they are not drawn."""
        state = self.line_state
        content = np.frombuffer(state.read(alignment=1), np.uint32).reshape(state.height, state.width)
        return remove_specks((content & 255).astype(np.uint8), speck_reach(self._thickness))

    @property
    def line_state(self) -> moderngl.Texture:
        """The lines of the last image, with one uint32 per pixel in the layout of
        :func:`fourd.rendering.ops.stylize.op.stylize_surface`. They include specks (very short lines), which are not
        drawn."""
        return self._targets.texture(f"lines {self._last}")

    def resize(self, size: tuple[int, int]) -> None:
        """Set the image size (width, height). If the size changes, the lines of the last image are dropped."""
        if size != self._targets.size:
            self._targets.resize(size)
            self.forget_lines()

    def forget_lines(self) -> None:
        """Forget the lines of the last image, for example because the next image is drawn from another camera."""
        self._has_state = False

    def draw(self, surface: SurfaceTextures, parameters: StyleParameters) -> moderngl.Texture:
        """Draw a surface in the style ``parameters``. The surface must have the size set by :meth:`resize`.

        Returns a texture with the alpha of the image and its colours, which are composited over the paper (the colour
        behind the scene). Row 0 of the texture is the top of the image. The next call overwrites the texture.
        """
        targets = self._targets
        disable_blending(self._context)
        targets.framebuffer(["depth", "normal"]).use()
        self._close.run({"inverse_depth": surface.inverse_depth, "normal": surface.normal})
        self._shade_surface(surface, parameters)
        self._thickness = parameters.thickness
        targets.framebuffer(["picture"]).use()
        self._draw_lines.run(
            {"shaded": targets.texture("shaded"), "lines": self.line_state},
            thickness=parameters.thickness,
            line_opacity=parameters.numbers.line_opacity,
            line_colour=parameters.numbers.line_colour,
        )
        return targets.texture("picture")

    def _shade_surface(self, surface: SurfaceTextures, parameters: StyleParameters) -> None:
        """Shade the surface without lines, and find the lines to draw."""
        targets, previous = self._targets, self._last
        self._last = 1 - previous
        targets.framebuffer(["shaded", f"lines {self._last}"]).use()
        numbers = {field.name: getattr(parameters.numbers, field.name) for field in fields(parameters.numbers)}
        self._shade.run(
            {
                "closed_depth": targets.texture("depth"),
                "closed_normal": targets.texture("normal"),
                "albedo": surface.albedo,
                "line_state": targets.texture(f"lines {previous}"),
                "table": self._upload_table(parameters.table),
            },
            has_state=self._has_state,
            detail_axis=DETAILS.index(parameters.detail),
            line_filter=LINE_FILTERS.index(parameters.lines),
            thickness=parameters.thickness,
            **numbers,
        )
        self._has_state = True

    def release(self) -> None:
        """Free all GL objects."""
        for item in (self._close, self._shade, self._draw_lines, self._targets):
            item.release()
        if self._table is not None:
            self._table.release()
            self._table = self._table_source = None

    def _upload_table(self, table: NDArray[np.uint8]) -> moderngl.Texture:
        if self._table is None or self._table_source is not table:
            if self._table is not None:
                self._table.release()
            content = np.ascontiguousarray(table).tobytes()
            self._table = self._context.texture((TONES, len(table)), 3, content, alignment=1)
            self._table.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._table_source = table
        return self._table
