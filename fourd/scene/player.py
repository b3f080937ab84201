"""Rendering of baked frames to 8-bit images, for real-time playback on the CPU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.play.op import PointPlayer
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.shade import make_shading


class Player:
    """Draws baked frames and reuses its workspace between images.

    Several threads may use one instance, because :class:`PointPlayer` serializes their calls.
    """

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
        """Draw the frame from ``camera`` as an (H, W, 4) uint8 image. The channels are RGB, composited over
        the background, and alpha.

        The image differs in two ways from the image that :meth:`fourd.scene.rendering.Scene.render` returns. First,
        values are rounded to bytes, before and after the scene's pixel filter (see
        :class:`fourd.scene.scene.SceneManifest`). Second, compositing of a pixel ends when its transmittance falls
        below :data:`fourd.rendering.ops.play.op.MIN_TRANSMITTANCE`.

        Args:
            frame: a frame whose values are all finite; :class:`fourd.scene.container.SceneReader` checks this.
            camera: a pinhole camera without lens distortion.
            layers: maximum number K of points that are composited per pixel. If ``layers`` is None, the manifest's
                value is used.
            background: RGB colour behind the points, in [0, 1].
            threads: number of threads. 0 means the environment variable FOURD_THREADS, or all cores if it is not set.
            out: C-contiguous (H, W, 4) uint8 array to draw into. If ``out`` is None, a new array is created.

        Raises:
            TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
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
            pixel_filter=manifest.pixel_filter,
            threads=threads,
            out=out,
        )
