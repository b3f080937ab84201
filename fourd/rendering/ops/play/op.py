"""Draws and depth-sorts baked points in NumPy arrays with the CPU kernels.

:class:`PointPlayer` and :class:`PointSorter` keep a workspace in native memory between calls, which only one call at a
time may use. Each object has a lock that serializes calls from several threads.
"""

from __future__ import annotations

from threading import Lock

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.points.validation import check_canvas, check_points, pack_camera
from fourd.rendering.ops.shade.shading import Shading
from fourd.rendering.ops.stylize.parameters import Surface

MIN_TRANSMITTANCE = 1e-3
"""Compositing of a pixel ends when its transmittance falls below this value.

The remaining points could change the colour by at most about a quarter of an 8-bit step.
"""


class PointPlayer:
    """Shades baked points and composites them into an 8-bit image in one native call.

    Several threads may use one instance, because a lock serializes their calls.
    """

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
        pixel_filter: float = 0.0,
        threads: int = 0,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw an image of N points, each with one colour per source view.

        Args:
            xyz: (N, 3) positions, world units.
            radius: (N,) radii, world units.
            density: (N,) opacities at the centre, in [0, 1].
            sh, blend_weights, rgb, shading: inputs of :func:`fourd.rendering.ops.shade.op.shade_points`.
            camera: a pinhole camera without lens distortion.
            layers: maximum number of points that are composited in a pixel.
            near: depth in world units at which points have faded out (:mod:`fourd.rendering.ops.play.near_fade`).
            background: red, green and blue values behind the points, in [0, 1].
            pixel_filter: ``side`` of :func:`fourd.rendering.ops.pixel_filter.op.filter_pixels`; 0 for no filter.
            threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores if it is not set.
            out: C-contiguous (H, W, 4) uint8 array to draw into. If None, a new array is allocated.

        Returns:
            (H, W, 4) uint8 image, which is ``out`` itself if given. The channels are RGB, composited over the
            background, and alpha.

        Raises:
            TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        """
        check_points({"xyz": xyz, "radius": xyz[:, 0], "density": xyz[:, 0]}, camera, layers, near)
        shape = (camera.height, camera.width, 4)
        out = np.empty(shape, np.uint8) if out is None else out
        check_canvas(out, shape, out.flags.c_contiguous)
        with self._lock:
            self._native.draw(
                *_native_points(xyz, radius, density, sh, blend_weights),
                rgb,
                *shading.arguments(),
                pack_camera(camera),
                layers,
                near,
                MIN_TRANSMITTANCE,
                list(background),
                pixel_filter,
                thread_count(threads),
                simd_name(),
                out,
            )
        return out

    def draw_surface(
        self,
        xyz: NDArray[np.float32],
        radius: NDArray[np.float16],
        density: NDArray[np.float16],
        sh: NDArray[np.float16],
        blend_weights: NDArray[np.float16],
        rgb: NDArray[np.uint8],
        normals: NDArray[np.uint8],
        shading: Shading,
        camera: Camera,
        *,
        layers: int,
        near: float,
        persistence: float = 0.0,
        threads: int = 0,
        out: Surface,
    ) -> None:
        """Draw the colours, depths and normals of the visible surface of N points.

        Args:
            normals: (N, 2) uint8 octahedral normals (:func:`fourd.scene.styles.normals.encode_octahedral`) in world
                axes.
            persistence: weight of the previous image's depths and normals, at least 0 and below 1. ``out`` must contain
                them before the call. They are used only at pixels where the inverse depths of the two images differ by
                at most 2% and the normals by at most 37 degrees. Use 0 for the first image from a camera.
            out: the surface to draw into, with the image size of ``camera``.

        For the other arguments and the errors, see :meth:`draw`.
        """
        check_points({"xyz": xyz, "radius": xyz[:, 0], "density": xyz[:, 0]}, camera, layers, near)
        if out.size != (camera.height, camera.width):
            raise ValueError(f"out: expected the camera's size {(camera.height, camera.width)}, got {out.size}")
        with self._lock:
            self._native.draw_surface(
                *_native_points(xyz, radius, density, sh, blend_weights),
                rgb,
                normals,
                *shading.arguments(),
                pack_camera(camera),
                layers,
                near,
                MIN_TRANSMITTANCE,
                persistence,
                thread_count(threads),
                simd_name(),
                out.albedo,
                out.inverse_depth,
                out.normal,
            )


def _native_points(xyz: NDArray[np.float32], *halves: NDArray[np.float16]) -> tuple[NDArray[np.generic], ...]:
    """Return the positions unchanged, and the float16 arrays as the uint16 arrays that the native module takes."""
    return (xyz, *(half.view(np.uint16) for half in halves))


class PointSorter:
    """Sorts points by depth. Several threads may use one instance, because a lock serializes their calls."""

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
        """Select the points that lie in the image of ``camera``, and return their indices, sorted by depth, nearest
        first. Points of equal depth are sorted by index.

        Occluded points are included. Points that :func:`fourd.rendering.render_points` does not draw are omitted:
        points nearer than ``near``, points outside the image, points whose radius or density is not positive, and
        points whose position is not finite.

        Args:
            xyz: (N, 3) positions, world units.
            radius: (N,) finite radii, world units.
            density: (N,) opacities at the centre, in [0, 1].
            camera: a pinhole camera without lens distortion.
            near: points with a camera depth below this number of world units are culled. Must be positive.
            threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores if it is not set.

        Raises:
            TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
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
