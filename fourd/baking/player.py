"""Pictures of baked frames as bytes, for real-time playback on the CPU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.baking.shade import make_shading
from fourd.cameras import Camera
from fourd.ops.play.op import PointPlayer


class Player:
    """Draws baked frames; keeps its workspace between pictures. Threads may share it; they take turns."""

    def __init__(self) -> None:
        """Raises ImportError if the native module is not built."""
        self._points = PointPlayer()

    def draw(
        self,
        frame: BakedFrame,
        camera: Camera,
        manifest: SceneManifest,
        *,
        layers: int | None = None,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        threads: int = 0,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw the frame from ``camera``: (H, W, 4) uint8, colour over the background, and alpha.

        The picture equals that of :meth:`fourd.baking.rendering.Scene.render` up to rounding to bytes and up to what
        lies behind a transmittance of :data:`fourd.ops.play.op.MIN_TRANSMITTANCE`.

        Args:
            frame: finite, as :class:`fourd.baking.container.SceneReader` guarantees.
            camera: an ideal pinhole.
            layers: K; None for the manifest's.
            background: red, green and blue in [0, 1].
            threads: 0 uses FOURD_THREADS if set, else all cores.
            out: (H, W, 4) uint8, C-contiguous, to draw into; None for a new array.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        return self._points.draw(
            frame.xyz,
            frame.radius,
            frame.density,
            frame.sh,
            frame.blend_weights,
            frame.rgb,
            make_shading(camera, manifest),
            camera,
            layers=manifest.layers if layers is None else layers,
            near=manifest.near,
            background=background,
            threads=threads,
            out=out,
        )
