"""Drawing and depth-sorting of baked points by the CPU kernels, for NumPy arrays.

Both classes keep a workspace in native memory between calls. The native objects must not run two calls at once, so
each object has a lock: threads that share an object take turns.
"""

from __future__ import annotations

from threading import Lock

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.ops.loading import load_native, simd_name, thread_count
from fourd.ops.points.validation import check_points, pack_camera
from fourd.ops.shade.shading import Shading

MIN_TRANSMITTANCE = 1e-3
"""A pixel ends below this transmittance, a quarter of a byte's step: what lies behind cannot change its bytes."""


class PointPlayer:
    """Shades and composites baked points to bytes in one native call. Threads may share it; they take turns."""

    def __init__(self) -> None:
        """Raises ImportError if the native module is not built."""
        self._native = load_native().Player()
        self._lock = Lock()

    def draw(
        self,
        xyz: NDArray[np.float32],
        radius: NDArray[np.float16],
        density: NDArray[np.float16],
        sh: NDArray[np.float16],
        blend_weights: NDArray[np.float16],
        rgb: NDArray[np.uint8],
        shading: Shading,
        camera: Camera,
        *,
        layers: int,
        near: float,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        threads: int = 0,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw N points in V source views.

        Args:
            xyz: (N, 3) positions, world units.
            radius: (N,) world units.
            density: (N,) in [0, 1].
            sh, blend_weights, rgb, shading: as in :func:`fourd.ops.shade.op.shade_points`.
            camera: an ideal pinhole.
            layers: K, the most points that a pixel composites.
            near: depth in world units below which points are culled.
            background: red, green and blue in [0, 1].
            threads: 0 uses FOURD_THREADS if set, else all cores.
            out: (H, W, 4) uint8, C-contiguous, to draw into; None for a new array.

        Returns:
            (H, W, 4) uint8, ``out`` if given: colour over the background, and alpha.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        check_points({"xyz": xyz, "radius": xyz[:, 0], "density": xyz[:, 0]}, camera, layers, near)
        out = _check_canvas(out, (camera.height, camera.width, 4))
        with self._lock:
            self._native.draw(
                xyz,
                radius.view(np.uint16),
                density.view(np.uint16),
                sh.view(np.uint16),
                blend_weights.view(np.uint16),
                rgb,
                *shading.arguments(),
                pack_camera(camera),
                layers,
                near,
                MIN_TRANSMITTANCE,
                list(background),
                thread_count(threads),
                simd_name(),
                out,
            )
        return out


def _check_canvas(out: NDArray[np.uint8] | None, shape: tuple[int, int, int]) -> NDArray[np.uint8]:
    if out is None:
        return np.empty(shape, np.uint8)
    if out.shape != shape or out.dtype != np.uint8 or not out.flags.c_contiguous:
        raise ValueError(f"out: expected contiguous uint8 of shape {shape}, got {out.dtype} of shape {out.shape}")
    return out


class PointSorter:
    """Sorts points by depth. Threads may share it; they take turns."""

    def __init__(self) -> None:
        """Raises ImportError if the native module is not built."""
        self._native = load_native().DepthSorter()
        self._lock = Lock()

    def sort(
        self,
        xyz: NDArray[np.float32],
        radius: NDArray[np.float16],
        density: NDArray[np.float16],
        camera: Camera,
        near: float,
        *,
        threads: int = 0,
    ) -> NDArray[np.uint32]:
        """Return the indices of the points that ``camera`` sees, nearest first, ties by index.

        Points that :func:`fourd.raster.render_points` does not draw are left out: those nearer than ``near``, outside
        the image, with a radius or density that is not positive, or with a position that is not finite.

        Args:
            xyz: (N, 3) positions, world units.
            radius: (N,) world units, finite.
            density: (N,) in [0, 1].
            camera: an ideal pinhole.
            near: depth in world units, positive.
            threads: 0 uses FOURD_THREADS if set, else all cores.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        check_points({"xyz": xyz, "radius": xyz[:, 0], "density": xyz[:, 0]}, camera, 1, near)
        order = np.empty(len(xyz), np.uint32)
        with self._lock:
            count = self._native.sort(
                xyz,
                radius.view(np.uint16),
                density.view(np.uint16),
                pack_camera(camera),
                camera.width,
                camera.height,
                near,
                thread_count(threads),
                simd_name(),
                order,
            )
        return order[:count]
