"""Pictures without a window, drawn by the same renderers."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fourd.errors import UserError
from fourd.viewer.display import RenderRequest
from fourd.viewer.rendering.cpu import CPURenderer
from fourd.viewer.rendering.renderers import Renderer, RendererChoice, RendererName, choose_renderer, make_renderer

if TYPE_CHECKING:
    import moderngl

    from fourd.viewer.gl.canvas import Canvas


class OffscreenRenderer:
    """Draws shots to arrays; by the CPU without any GL. Use as a context manager."""

    def __init__(self, wanted: RendererName | Literal["auto"]) -> None:
        """Raises UserError when a GL renderer is wanted and there is no GL."""
        self._context = None if wanted == "cpu" else _context_if_any(wanted)
        self.chosen: RendererChoice = choose_renderer(wanted, None if self._context is None else _driver(self._context))
        if self.chosen.name == "cpu":
            self._release_context()
        self._renderer: Renderer = make_renderer(self.chosen.name, self._context)
        self._canvas = None if self._context is None else _canvas(self._context)

    def picture(self, request: RenderRequest) -> NDArray[np.uint8]:
        """(H, W, 3) uint8, a new array."""
        if isinstance(self._renderer, CPURenderer):
            return self._renderer.picture(request)[..., :3].copy()
        assert self._canvas is not None
        self._renderer.draw(request, self._canvas, wait=True)
        return self._canvas.pixels()

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


def _context_if_any(wanted: RendererName | Literal["auto"]) -> moderngl.Context | None:
    from fourd.viewer.gl.context import offscreen_context

    try:
        return offscreen_context()
    except UserError:
        if wanted != "auto":
            raise
        return None


def _canvas(context: moderngl.Context) -> Canvas:
    from fourd.viewer.gl.canvas import Canvas

    return Canvas(context)


def _driver(context: moderngl.Context) -> str:
    from fourd.viewer.gl.context import driver_name

    return driver_name(context)
