"""Rendering without a window."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.viewer.display import RenderRequest
from fourd.viewer.rendering.cpu import CPURenderer
from fourd.viewer.rendering.renderer_name import RendererName
from fourd.viewer.rendering.renderers import Renderer, RendererChoice, choose_renderer, make_renderer

if TYPE_CHECKING:
    import moderngl

    from fourd.viewer.gl.canvas import Canvas


class OffscreenRenderer:
    """Renders requests to arrays with any renderer. The cpu renderer needs no OpenGL.

    Use an OffscreenRenderer as a context manager.
    """

    def __init__(self, requested: RendererName | Literal["auto"]) -> None:
        """Raises UserError if an OpenGL renderer is requested but OpenGL is not available."""
        self._context = None if requested == "cpu" else _make_context(requested)
        self.choice: RendererChoice = choose_renderer(
            requested, None if self._context is None else _driver_name(self._context)
        )
        if self.choice.name == "cpu":
            self._release_context()
        self._renderer: Renderer = make_renderer(self.choice.name, self._context)
        self._canvas = None if self._context is None else _make_canvas(self._context)

    def render(self, request: RenderRequest) -> NDArray[np.uint8]:
        """Return the rendered image as a new uint8 array (H, W, 3)."""
        if isinstance(self._renderer, CPURenderer):
            return self._renderer.render(request)[..., :3].copy()
        assert self._canvas is not None
        self._renderer.draw(request, self._canvas, wait=True)
        return self._canvas.read_rgb8()

    def __enter__(self) -> OffscreenRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._renderer.release()
        if self._canvas is not None:
            self._canvas.release()
        self._release_context()

    def _release_context(self) -> None:
        if self._context is not None:
            self._context.release()
            self._context = None


def _make_context(requested: RendererName | Literal["auto"]) -> moderngl.Context | None:
    """Create an OpenGL context. Returns None if OpenGL is not available and the renderer is chosen automatically."""
    from fourd.viewer.gl.context import offscreen_context

    try:
        return offscreen_context()
    except UserError:
        if requested != "auto":
            raise
        return None


def _make_canvas(context: moderngl.Context) -> Canvas:
    from fourd.viewer.gl.canvas import Canvas

    return Canvas(context)


def _driver_name(context: moderngl.Context) -> str:
    from fourd.viewer.gl.context import driver_name

    return driver_name(context)
