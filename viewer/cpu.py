"""The renderer that needs no GPU: the native kernel, whose picture is blitted where there is a window."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.baking.player import Player
from fourd.viewer.look import Shot

if TYPE_CHECKING:
    import moderngl

    from fourd.viewer.gl.blit import Blit


class CPURenderer:
    """Draws shots with the native kernel. A GL context is needed for :meth:`draw` alone."""

    name = "cpu"
    behind = 0
    sort_seconds = 0.0

    def __init__(self, context: moderngl.Context | None = None) -> None:
        """Raises ImportError where the native module is not built."""
        self._player = Player()
        self._pixels: NDArray[np.uint8] | None = None
        self._blit: Blit | None = None
        if context is not None:
            from fourd.viewer.gl.blit import Blit

            self._blit = Blit(context)

    def picture(self, shot: Shot) -> NDArray[np.uint8]:
        """The shot, (H, W, 4) uint8; the array is drawn over by the next call."""
        shape = (shot.camera.height, shot.camera.width, 4)
        if self._pixels is None or self._pixels.shape != shape:
            self._pixels = np.empty(shape, np.uint8)
        return self._player.draw(
            shot.frame,
            shot.camera,
            shot.manifest,
            layers=shot.look.layers,
            background=shot.look.background,
            out=self._pixels,
        )

    def draw(self, shot: Shot, target: moderngl.Framebuffer, wait: bool = False) -> None:
        """Draw into ``target``, which has the camera's size."""
        assert self._blit is not None, "made without a context"
        self._blit.draw(self.picture(shot), target)

    def release(self) -> None:
        """Give back every GL object."""
        if self._blit is not None:
            self._blit.release()
