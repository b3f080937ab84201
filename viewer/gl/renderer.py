"""The OpenGL renderer, which uploads, sorts, projects and composites points."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from fourd.scene import BakedFrame
from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.compositors import Compositor
from fourd.viewer.gl.depth_order import DepthOrder, DepthOrders
from fourd.viewer.gl.discs import Paint
from fourd.viewer.gl.frame_textures import FrameTextures, Precision
from fourd.viewer.gl.styled import StyledDrawing, depth_unit


class GLRenderer:
    """Renders requests with one compositor. An instance belongs to one OpenGL context and one thread."""

    def __init__(
        self,
        context: moderngl.Context,
        name: str,
        compositor: Compositor,
        orders: DepthOrders,
        precision: Precision = "float16",
    ) -> None:
        self.name = name
        self._context = context
        self._compositor = compositor
        self._orders = orders
        # Two sets of textures are needed, because the previous frame is still drawn while the next frame's points are
        # being sorted.
        self._textures = [FrameTextures(context, precision) for _ in range(2)]
        self._styled: StyledDrawing | None = None
        self._stale_images = 0
        self.sort_seconds = 0.0

    @property
    def stale_images(self) -> int:
        """Number of successive images, counted back from the last one, that were drawn with the depth order of an
        earlier request.

        The number is 0 if the last image was drawn with its own depth order.
        """
        return self._stale_images

    @property
    def style_seconds(self) -> float:
        """GPU time of the stylizer in seconds for the newest image whose time is known, or 0 if no style is used."""
        return 0.0 if self._styled is None else self._styled.style_seconds

    @property
    def line_strength(self) -> NDArray[np.uint8]:
        """Strength of the lines that a style has drawn in the last image, as an array (H, W). Raises RuntimeError if
        the image has no style."""
        if self._styled is None:
            raise RuntimeError("line_strength: expected an image in a style, got none; draw one first")
        return self._styled.line_strength

    def draw(self, request: RenderRequest, canvas: Canvas, wait: bool = False) -> None:
        """Draw ``request`` into ``canvas``, at the image size of the request's camera.

        If ``wait`` is True, the image shows the frame of ``request``, drawn in the depth order of ``request``. If
        ``wait`` is False, the frame and the depth order may be those of an earlier request.
        """
        order = self._orders.order(request, wait)
        self._stale_images = 0 if order.matches(request) else self._stale_images + 1
        self.sort_seconds = order.seconds
        ordered_request = replace(request, frame=order.frame)
        self._context.disable(moderngl.CULL_FACE | moderngl.BLEND | moderngl.DEPTH_TEST)
        # Transform feedback needs a bound framebuffer, and a context without a window has no default framebuffer.
        target = canvas.framebuffer(request.camera.width, request.camera.height)
        target.use()
        if request.settings.style is not None:
            self._draw_styled(ordered_request, order, target)
            return
        self._release_styled()
        self._compositor.discs.project(self._upload(order.frame), order.points, ordered_request)
        self._compositor.draw(ordered_request, target)

    def release(self) -> None:
        """Free all GL objects and stop the sorting thread."""
        self._release_styled()
        self._orders.release()
        self._compositor.release()
        for textures in self._textures:
            textures.release()

    def _draw_styled(self, request: RenderRequest, order: DepthOrder, target: moderngl.Framebuffer) -> None:
        if self._styled is None:
            self._styled = StyledDrawing(self._context)
        textures = self._upload(self._styled.with_normals(order.frame, request.manifest))
        unit = depth_unit(request.camera, request.manifest)

        def project(paint: Paint) -> None:
            self._compositor.discs.project(textures, order.points, request, paint, unit)

        self._styled.draw(self._compositor, project, request, target)

    def _release_styled(self) -> None:
        """Free the objects that only styles need, and all frame textures.

        The frame textures are freed so that no outdated normals are drawn. A frame without stored normals is uploaded
        with estimated normals while a style is used, and without normals otherwise. If the textures were kept, uploads
        without normals could replace or move the background points, while the normals of the earlier background points
        would stay in the textures. When a style is used again, a background that is already in the textures is not
        uploaded again, so its points would be drawn with these outdated normals.
        """
        if self._styled is None:
            return
        self._styled.release()
        self._styled = None
        for textures in self._textures:
            textures.release()

    def _upload(self, frame: BakedFrame) -> FrameTextures:
        for textures in self._textures:
            if textures.frame is frame:
                return textures
        self._textures.reverse()
        self._textures[0].load(frame)
        return self._textures[0]
