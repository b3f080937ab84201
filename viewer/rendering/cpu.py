"""The renderer that needs no GPU: the native kernel, whose bytes are uploaded where there is a window."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.baking.player import Player
from fourd.viewer.display import RenderRequest

if TYPE_CHECKING:
    from fourd.viewer.gl.canvas import Canvas


class CPURenderer:
    """Draws shots with the native kernel."""

    name = "cpu"
    behind = 0
    sort_seconds = 0.0

    def __init__(self) -> None:
        """Raises ImportError where the native module is not built."""
        self._player = Player()
        self._pixels: NDArray[np.uint8] | None = None

    def picture(self, request: RenderRequest) -> NDArray[np.uint8]:
        """The request, (H, W, 4) uint8; the array is drawn over by the next call."""
        shape = (request.camera.height, request.camera.width, 4)
        if self._pixels is None or self._pixels.shape != shape:
            self._pixels = np.empty(shape, np.uint8)
        return self._player.draw(
            request.frame,
            request.camera,
            request.manifest,
            layers=request.settings.layers,
            background=request.settings.background,
            out=self._pixels,
        )

    def draw(self, request: RenderRequest, canvas: Canvas, wait: bool = False) -> None:
        """Draw on ``canvas``, in the camera's size."""
        canvas.write(self.picture(request))

    def release(self) -> None:
        """Nothing is held of GL's."""
