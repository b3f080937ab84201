"""Draws frames in a style with OpenGL. A compositor draws the visible surface of the points, and the stylizer turns
this surface into the styled image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene import BakedFrame, SceneManifest
from fourd.scene.styled.normals import FrameNormals
from fourd.scene.styled.player import is_same_camera
from fourd.scene.styles import Style, view_style
from fourd.scene.styles.tables import make_table
from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.compositors import Compositor, OverBackground
from fourd.viewer.gl.discs import PAINTS, Paint
from fourd.viewer.gl.passes import FullScreenPass, RenderTargets, disable_blending
from fourd.viewer.gl.stylizer import GLStylizer, SurfaceTextures
from fourd.viewer.gl.timer import GPUTimer

Project = Callable[[Paint], None]
"""The type of a function that projects the points of a request. The argument selects what the discs show: colours,
normals or depths."""


class SurfaceBuffer:
    """The visible surface of points, drawn by any compositor.

    The same compositor runs three times, for colours, normals and depths, so that a disc has the same weight in all
    three.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        formats = {"colour": (4, "f2"), "normal": (4, "f4"), "depth": (4, "f4"), "albedo": (4, "f1")}
        for index in range(2):
            formats[f"inverse depth {index}"], formats[f"normal {index}"] = (1, "f4"), (4, "f1")
        self._targets = RenderTargets(context, formats)
        self._convert = FullScreenPass(context, "stylize/surface.frag.js")
        self._last = 0

    def draw(
        self, compositor: Compositor, project: Project, request: RenderRequest, persistence: float
    ) -> SurfaceTextures:
        """Draw the surface. Use the returned textures before the next call, because that call overwrites some of them.

        Args:
            persistence: the surface is averaged with the surface of the previous call, which gets this weight, at
                least 0 and below 1. Pass 0 if the previous surface was drawn for another camera.
        """
        targets, size = self._targets, (request.camera.width, request.camera.height)
        if size != targets.size:
            targets.resize(size)
            persistence = 0.0
        for paint in PAINTS:
            framebuffer = targets.framebuffer([paint])
            framebuffer.use()  # the projection uses transform feedback, which needs a bound framebuffer
            project(paint)
            compositor.draw(request, framebuffer, is_picture=False)
        previous, self._last = self._last, 1 - self._last
        names = ["albedo", f"inverse depth {self._last}", f"normal {self._last}"]
        targets.framebuffer(names).use()
        disable_blending(self._context)
        self._convert.run(
            {
                "colours": targets.texture("colour"),
                "normals": targets.texture("normal"),
                "depths": targets.texture("depth"),
                "old_inverse_depth": targets.texture(f"inverse depth {previous}"),
                "old_normal": targets.texture(f"normal {previous}"),
            },
            depth_unit=depth_unit(request.camera, request.manifest),
            is_upside_down=True,
            persistence=persistence,
        )
        return SurfaceTextures(*(targets.texture(name) for name in names))

    def release(self) -> None:
        """Free all GL objects."""
        self._convert.release()
        self._targets.release()


class StyledDrawing:
    """Draws requests in their style. As with :class:`fourd.scene.styled.player.StyledPlayer`, lines do not flicker in
    successive images from the same camera."""

    def __init__(self, context: moderngl.Context) -> None:
        self._surface = SurfaceBuffer(context)
        self._stylizer = GLStylizer(context)
        self._copy = OverBackground(context)
        self._timer = GPUTimer()
        self._normals = FrameNormals()
        self._frames: list[tuple[BakedFrame, BakedFrame]] = []
        self._camera: Camera | None = None
        self._table: tuple[Style, NDArray[np.uint8]] | None = None

    @property
    def style_seconds(self) -> float:
        """GPU time of the stylizer in seconds for the newest image whose time is known. It does not include the time to
        draw the surface."""
        return self._timer.seconds

    @property
    def line_strength(self) -> NDArray[np.uint8]:
        """Strength of the lines in the last image, as an array (H, W). Specks (very short lines) are removed, because
        they are not drawn."""
        return self._stylizer.line_strength

    def with_normals(self, frame: BakedFrame, manifest: SceneManifest) -> BakedFrame:
        """Return the frame itself if it has normals, and otherwise a copy with estimated normals.

        The copies of the last two frames are kept. Repeated calls with one of these frames return the same object,
        because the renderer uploads a frame to the GPU again if it gets another object.
        """
        if frame.normals is not None:
            return frame
        for source, complete in self._frames:
            if source is frame:
                return complete
        complete = replace(frame, normals=self._normals.get(frame, manifest))
        self._frames = [(frame, complete), *self._frames[:1]]
        return complete

    def draw(
        self, compositor: Compositor, project: Project, request: RenderRequest, target: moderngl.Framebuffer
    ) -> None:
        """Draw a request that has a style. Raises UserError if the style's shade map, a PNG with the colours from unlit
        to lit, cannot be read."""
        settings, camera = request.settings, request.camera
        assert settings.style is not None
        is_same_style = self._table is not None and self._table[0] == settings.style
        if self._table is None or not is_same_style:
            self._table = (settings.style, make_table(settings.style))
        rests = self._camera is not None and is_same_camera(self._camera, camera)
        self._camera = camera
        persistence = settings.style.persistence if rests else 0.0
        surface = self._surface.draw(compositor, project, request, persistence)
        self._stylizer.resize((camera.width, camera.height))
        if not (rests and is_same_style):
            self._stylizer.forget_lines()
        parameters = view_style(settings.style, self._table[1], camera, request.manifest.focus, settings.background)
        with self._timer:
            picture = self._stylizer.draw(surface, parameters)
        self._copy.copy(picture, target)

    def release(self) -> None:
        """Free all GL objects."""
        for item in (self._surface, self._stylizer, self._copy, self._timer):
            item.release()


def depth_unit(camera: Camera, manifest: SceneManifest) -> float:
    """Return the unit of composited depths, in world units. It is the distance from the camera to the centre of the
    scene, so that composited depths are near 1, where float16 is precise."""
    return max(float(np.linalg.norm(np.asarray(manifest.focus) - camera.centre)), 1e-6)
