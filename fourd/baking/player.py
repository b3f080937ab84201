"""Pictures of baked frames as bytes: shading and compositing in one native call, for real time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.baking.shade import shading_arguments
from fourd.cameras import Camera
from fourd.ops.loading import native, simd_name, thread_count
from fourd.ops.points.validation import check_points, pack_camera

HIDDEN = 1e-3
"""Light below a quarter of a byte's step: what lies behind it cannot be seen."""


class Player:
    """Draws frames, keeping its memory from one picture to the next. Not to be shared between threads."""

    def __init__(self) -> None:
        """Raises ImportError where the native module is not built."""
        self._native = native().Player()

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
        """The frame from ``camera``, (H, W, 4) uint8: colour over the background, and alpha.

        The same picture as :meth:`fourd.baking.rendering.Scene.render` gives, but for rounding to
        bytes and for what less than :data:`HIDDEN` of the light comes from.

        Args:
            frame: finite, as :class:`fourd.baking.container.SceneReader` guarantees.
            camera: an ideal pinhole.
            layers: K; None for the manifest's.
            background: red, green and blue in [0, 1].
            threads: 0 for FOURD_THREADS if that is set, else one a core.
            out: where to draw, (H, W, 4) uint8, contiguous; None for a new array.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        layers = manifest.layers if layers is None else layers
        shape = (camera.height, camera.width, 4)
        arrays = {"xyz": frame.xyz, "radius": frame.xyz[:, 0], "density": frame.xyz[:, 0]}
        check_points(arrays, camera, layers, manifest.near)
        if out is None:
            out = np.empty(shape, np.uint8)
        elif out.shape != shape or out.dtype != np.uint8 or not out.flags.c_contiguous:
            raise ValueError(f"out: expected contiguous uint8 of shape {shape}, got {out.dtype} of shape {out.shape}")
        self._native.draw(
            frame.xyz,
            frame.radius.view(np.uint16),
            frame.density.view(np.uint16),
            frame.sh.view(np.uint16),
            frame.blend_weights.view(np.uint16),
            frame.rgb,
            *shading_arguments(camera, manifest),
            pack_camera(camera),
            layers,
            manifest.near,
            HIDDEN,
            list(background),
            thread_count(threads),
            simd_name(),
            out,
        )
        return out
