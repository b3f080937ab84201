"""Draws a session into a window. The renderer can be switched while the window is open."""

from __future__ import annotations

import math
from typing import Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import REQUIRED_VERSION, driver_name
from fourd.viewer.rendering.renderers import Renderer, RendererChoice, RendererName, choose_renderer, make_renderer
from fourd.viewer.window import Window

_FAINT = 0.01
"""A line counts as faded in when its strength differs from its final strength by at most this fraction of the initial
difference. While playback is paused, the image is drawn again until all lines have faded in.
"""


class WindowRenderer:
    """A renderer, the canvas it draws into, and the window that shows the canvas."""

    def __init__(self, window: Window, requested: RendererName | Literal["auto"]) -> None:
        """Raises UserError when the requested renderer is not available."""
        self.window = window
        self.context = moderngl.create_context(require=REQUIRED_VERSION)
        self.choice: RendererChoice = choose_renderer(requested, driver_name(self.context))
        self.renderer: Renderer = make_renderer(self.choice.name, self.context)
        self._canvas = Canvas(self.context)
        self._screen: moderngl.Framebuffer | None = None
        self._drawn: RenderRequest | None = None
        self._unsettled_images = 0

    @property
    def is_settling(self) -> bool:
        """Whether lines of the last image would become stronger if it were drawn again. Lines fade in after a change of
        the frame, but not after a change of the camera."""
        return self._unsettled_images > 0

    @property
    def is_stale(self) -> bool:
        """Whether the last image was drawn with the depth order of an earlier request."""
        return self.renderer.stale_images > 0

    def switch(self, name: RendererName, reason: str = "as requested") -> None:
        """Switch to another renderer. If the new renderer raises an exception, the current renderer stays."""
        renderer = make_renderer(name, self.context)
        self.renderer.release()
        self.renderer, self.choice, self._drawn = renderer, RendererChoice(name, reason), None

    def reset(self) -> None:
        """Replace the current renderer by a new one of the same kind.

        This is needed after a change of the scene, because the textures and threads of the old renderer may still hold
        frames of the closed scene.
        """
        self.renderer.release()
        self.renderer, self._drawn = make_renderer(self.choice.name, self.context), None

    def invalidate(self) -> None:
        """Force the next request to be drawn, even if it is equal to the last request."""
        self._drawn = None

    def needs_draw(self, request: RenderRequest) -> bool:
        """Return True unless the canvas already shows ``request``, drawn in its own depth order."""
        return self.is_stale or not self._is_last(request)

    def draw(self, request: RenderRequest) -> None:
        """Draw into the canvas. Raises UserError."""
        self.renderer.draw(request, self._canvas)
        last, style = self._drawn, request.settings.style
        if self._is_last(request):
            self._unsettled_images = max(0, self._unsettled_images - 1)
        elif style is None or last is None or last.camera is not request.camera or last.settings.style != style:
            self._unsettled_images = 0
        else:
            self._unsettled_images = _images_to_settle(style.persistence)
        self._drawn = request

    def draw_exact(self, request: RenderRequest) -> NDArray[np.uint8]:
        """Draw a request in its own depth order, not in that of an earlier request. Return the image as a uint8 array
        (H, W, 3). The window's image must be drawn again afterwards. Raises UserError."""
        self._drawn = None
        self.renderer.draw(request, self._canvas, wait=True)
        return self._canvas.read_rgb8()

    def present(self, shows_image: bool, empty: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Copy the canvas to the window's back buffer. If ``shows_image`` is False, or if the canvas does not have the
        window's size, fill the back buffer with the colour ``empty`` instead."""
        size = self.window.framebuffer_size
        if self._screen is None or self._screen.size != size:
            self._screen = self.context.detect_framebuffer(0)
        self._screen.use()
        if shows_image and self._canvas.size == size:
            self.window.copy_framebuffer(self._canvas.framebuffer(*size).glo)
            self._screen.use()
        else:
            self._screen.clear(*empty)

    def _is_last(self, request: RenderRequest) -> bool:
        """Return True if a request is equal to the last one."""
        last = self._drawn
        return (
            last is not None
            and request.frame is last.frame
            and request.camera is last.camera
            and request.settings == last.settings
        )

    def release(self) -> None:
        """Free all GL objects and stop threads."""
        self.renderer.release()
        self._canvas.release()


def _images_to_settle(persistence: float) -> int:
    """Return how many more times a frame must be drawn until its lines have their final strength."""
    return math.ceil(math.log(_FAINT) / math.log(persistence)) if persistence > 0 else 0
