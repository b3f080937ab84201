"""The cpu renderer, which uses the native kernel and needs no GPU."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.aligned import zeros_aligned
from fourd.scene.player import Player
from fourd.scene.styled.player import StyledPlayer
from fourd.viewer.display import RenderRequest

if TYPE_CHECKING:
    from fourd.viewer.gl.canvas import Canvas


class CPURenderer:
    """Renders with the native kernel. In a window, the rendered image is uploaded to OpenGL."""

    name = "cpu"
    stale_images = 0
    style_seconds = 0.0
    sort_seconds = 0.0

    def __init__(self) -> None:
        """Raises ImportError if the native module is not built."""
        self._player = Player()
        self._styled: StyledPlayer | None = None
        self._pixels: NDArray[np.uint8] | None = None

    @property
    def line_strength(self) -> NDArray[np.uint8]:
        """Strength of the lines in the last image that was drawn in a style, as an array (H, W). Raises RuntimeError if
        the renderer has not yet drawn an image in a style."""
        return (self._styled or StyledPlayer()).line_strength

    def render(self, request: RenderRequest) -> NDArray[np.uint8]:
        """Return the rendered image as a uint8 array (H, W, 4), which the next call of :meth:`render` overwrites."""
        shape = (request.camera.height, request.camera.width, 4)
        if self._pixels is None or self._pixels.shape != shape:
            self._pixels = zeros_aligned(shape, np.uint8)
        frame, camera, manifest, settings = request.frame, request.camera, request.manifest, request.settings
        layers, background = settings.layers, settings.background
        if settings.style is None:
            self.style_seconds = 0.0
            return self._player.draw(frame, camera, manifest, layers=layers, background=background, out=self._pixels)
        self._styled = self._styled or StyledPlayer()
        self._styled.draw(
            frame, camera, manifest, settings.style, layers=layers, background=background, out=self._pixels
        )
        self.style_seconds = self._styled.style_seconds
        return self._pixels

    def draw(self, request: RenderRequest, canvas: Canvas, wait: bool = False) -> None:
        """Draw ``request`` into ``canvas``, at the image size of the request's camera."""
        canvas.write(self.render(request))

    def release(self) -> None:
        """Does nothing, because this renderer owns no GL objects."""
