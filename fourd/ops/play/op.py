"""Drawing and depth-sorting of baked points by the CPU kernels, for NumPy arrays.

:class:`PointPlayer` and :class:`PointSorter` keep a workspace in native memory between calls. The native object
supports only one call at a time. A lock therefore serializes calls from several threads to one object.
"""

from __future__ import annotations

from threading import Lock

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.ops.loading import load_native, simd_name, thread_count
from fourd.ops.points.validation import check_canvas, check_points, pack_camera
from fourd.ops.shade.shading import Shading
from fourd.ops.stylize.parameters import Surface

MIN_TRANSMITTANCE = 1e-3
"""Compositing of a pixel ends when the pixel's transmittance falls below this value.

The points that are not composited could change the colour by at most a quarter of an 8-bit step.
"""


class PointPlayer:
    """Shades baked points and composites them to an 8-bit image in one native call.

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
        threads: int = 0,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw an image of N points. Each point has one colour per source view.

        Args:
            xyz: (N, 3) positions, world units.
            radius: (N,) radii, world units.
            density: (N,) opacities at the centre, in [0, 1].
            sh, blend_weights, rgb, shading: inputs of :func:`fourd.ops.shade.op.shade_points`.
            camera: a pinhole camera without lens distortion.
            layers: maximum number of points that a pixel composites.
            near: points with a camera depth below this number of world units are culled.
            background: red, green and blue behind the points, in [0, 1].
            threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores if it is not set.
            out: C-contiguous (H, W, 4) uint8 array to draw into. If ``out`` is None, a new array is allocated.

        Returns:
            (H, W, 4) uint8 image. The channels of the image are RGB, composited over the background, and alpha. If
            ``out`` is given, ``out`` itself is returned.

        Raises:
            TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        """
        check_points({"xyz": xyz, "radius": xyz[:, 0], "density": xyz[:, 0]}, camera, layers, near)
        shape = (camera.height, camera.width, 4)
        if out is None:
            out = np.empty(shape, np.uint8)
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
        """Draw the visible surface of N points: colours, depth and normals.

        Args:
            normals: (N, 2) uint8 octahedral normals (:func:`fourd.stylize.normals.encode_octahedral`) in world axes.
            persistence: weight of the previous picture, at least 0 and below 1. Before the call, ``out`` must contain
                the depths and normals of the previous picture. The previous values are used only at pixels where the
                inverse depths of the two pictures differ by at most 2% and their normals differ by at most 37 degrees.
                Use 0 for the first picture from a camera.
            out: the surface to draw into. The surface must have the image size of ``camera``.

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
    """Return the positions unchanged, and the float16 arrays as the 16-bit words that the native module takes."""
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
        """Return the indices of the points in the image of ``camera``, sorted by depth with the nearest point first.
        Points of equal depth are sorted by index.

        Occluded points are included. Points that :func:`fourd.raster.render_points` does not draw are omitted: points
        nearer than ``near``, points outside the image, points whose radius or density is not positive, and points whose
        position is not finite.

        Args:
            xyz: (N, 3) positions, world units.
            radius: (N,) finite radii, world units.
            density: (N,) opacities at the centre, in [0, 1].
            camera: a pinhole camera without lens distortion.
            near: points with a camera depth below this number of world units are culled. Above 0.
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
