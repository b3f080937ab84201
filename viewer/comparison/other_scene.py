"""A second scene, which the window shows from the view of the first one and in step with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import moderngl

from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.rendering.renderers import Renderer, RendererName, make_renderer
from fourd.viewer.session import Session


class OtherScene:
    """Opens a scene, and draws it into a texture."""

    def __init__(self, context: moderngl.Context, path: Path) -> None:
        """Start to open the scene in ``path``. An error is reported by :meth:`take_error`."""
        self.path = path
        self._context = context
        self._session = Session(DisplaySettings(layers=0))
        self._session.open(path)
        self._canvas = Canvas(context)
        self._renderer: Renderer | None = None
        self._drawn: RenderRequest | None = None

    @property
    def is_busy(self) -> bool:
        """Whether the scene is being opened or one of its frames is being read, so that the first scene waits."""
        return self._session.opening is not None or self._session.is_waiting

    @property
    def is_stale(self) -> bool:
        """Whether the last image was drawn with an earlier depth order."""
        return self._renderer is not None and self._renderer.stale_images > 0

    @property
    def error(self) -> Exception | None:
        """The reason why the scene could not be opened, or None."""
        return self._session.error

    @property
    def texture(self) -> int | None:
        """OpenGL name of the texture with the image, whose row 0 is at the bottom; None until there is one."""
        if self._drawn is None:
            return None
        (texture,) = self._canvas.framebuffer(*self._canvas.size).color_attachments
        assert isinstance(texture, moderngl.Texture)
        texture.swizzle = "RGB1"  # the image covers what is below it, also where the scene has no points
        return texture.glo

    @property
    def drawn(self) -> RenderRequest | None:
        """The image that was drawn last, or None until there is one."""
        return self._drawn

    def take_error(self) -> str:
        """Return the reason why the scene or a frame cannot be read, once."""
        error, self._session.message = self._session.message, ""
        return error

    def follow(self, first: Session, size: tuple[int, int], shift: tuple[float, float], renderer: RendererName) -> None:
        """Draw the frame at the time of the first scene, from its view and with its settings, if the image has changed.

        ``size`` is that of the framebuffer, and ``shift`` moves the picture as in :meth:`Session.render_request`.
        """
        opened = self._session.take_opened()
        if first.pose is None:
            return
        if opened is not None:
            self._session.show(opened, first.pose)
        if self._session.scene is None:
            return
        self._session.pose = first.pose
        self._session.settings = replace(first.settings, layers=self._session.scene.manifest.layers)
        seconds = first.playback.frame / first.playback.fps
        self._session.playback.seek(round(seconds * self._session.playback.fps))
        request = self._session.render_request(size, shift=shift)
        if request is not None:
            self._draw(request, renderer)

    def release(self) -> None:
        """Close the scene and free all GL objects."""
        self._session.close()
        self._canvas.release()
        if self._renderer is not None:
            self._renderer.release()

    def _draw(self, request: RenderRequest, name: RendererName) -> None:
        if self._renderer is None or self._renderer.name != name:
            if self._renderer is not None:
                self._renderer.release()
            self._renderer, self._drawn = make_renderer(name, self._context), None
        last = self._drawn
        is_same = (
            last is not None
            and (last.frame is request.frame and last.camera is request.camera and last.settings == request.settings)
            and self._renderer.stale_images == 0
        )
        if not is_same:
            self._renderer.draw(request, self._canvas)
            self._drawn = request
