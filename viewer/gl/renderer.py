"""A renderer that draws with OpenGL: uploads, orders, composites and shows."""

from __future__ import annotations

from dataclasses import replace

import moderngl

from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.arrays import Precision, UploadedFrame
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.depth_order import Orders
from fourd.viewer.gl.techniques import Technique


class GLRenderer:
    """Draws shots with one technique. Not to be shared between contexts or threads."""

    def __init__(
        self,
        context: moderngl.Context,
        name: str,
        technique: Technique,
        orders: Orders,
        precision: Precision = "float16",
    ) -> None:
        self.name = name
        self._context = context
        self._technique = technique
        self._orders = orders
        # Two: while a frame waits for its order, the one before is drawn.
        self._uploaded = [UploadedFrame(context, precision) for _ in range(2)]
        self._behind = 0
        self.sort_seconds = 0.0

    @property
    def behind(self) -> int:
        """How many pictures in a row were drawn with an order that is not their own; 0 at rest."""
        return self._behind

    def draw(self, request: RenderRequest, canvas: Canvas, wait: bool = False) -> None:
        """Draw on ``canvas``, in the camera's size; with ``wait``, with the request's own order."""
        order = self._orders.order(request, wait)
        self._behind = 0 if order.fits(request) else self._behind + 1
        self.sort_seconds = order.seconds
        drawn = replace(request, frame=order.frame)
        self._context.disable(moderngl.CULL_FACE | moderngl.BLEND | moderngl.DEPTH_TEST)
        # Without a window there is no default framebuffer, and transform feedback fails while none is in use.
        target = canvas.sized(request.camera.width, request.camera.height)
        target.use()
        self._technique.discs.place(self._upload(drawn), order.points, drawn)
        self._technique.draw(drawn, target)

    def release(self) -> None:
        """Give back every GL object and stop the sorting."""
        self._orders.release()
        self._technique.release()
        for uploaded in self._uploaded:
            uploaded.release()

    def _upload(self, request: RenderRequest) -> UploadedFrame:
        for uploaded in self._uploaded:
            if uploaded.frame is request.frame:
                return uploaded
        self._uploaded.reverse()
        self._uploaded[0].load(request.frame)
        return self._uploaded[0]
