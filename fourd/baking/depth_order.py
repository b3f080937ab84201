"""A frame's points in the order of their depth, for renderers that draw them one over the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame
from fourd.cameras import Camera
from fourd.ops.loading import native, simd_name, thread_count
from fourd.ops.points.validation import check_points, pack_camera


class DepthSorter:
    """Sorts points by depth, keeping its memory from one time to the next. Not to be shared between threads."""

    def __init__(self) -> None:
        """Raises ImportError where the native module is not built."""
        self._native = native().DepthSorter()

    def sort(self, frame: BakedFrame, camera: Camera, near: float, *, threads: int = 0) -> NDArray[np.uint32]:
        """Indices of the points that ``camera`` sees, nearest first and ties by index.

        Left out are points that :func:`fourd.raster.render_points` would not draw: nearer than
        ``near``, outside the image, of no size or density, or at a place that is not finite.

        Args:
            frame: its radii and densities are finite, as :class:`fourd.baking.container.SceneReader` guarantees.
            camera: an ideal pinhole.
            near: world units, above 0.
            threads: 0 for FOURD_THREADS if that is set, else one a core.
        """
        arrays = {"xyz": frame.xyz, "radius": frame.xyz[:, 0], "density": frame.xyz[:, 0]}
        check_points(arrays, camera, 1, near)
        order = np.empty(frame.point_count, np.uint32)
        count = self._native.sort(
            frame.xyz,
            frame.radius.view(np.uint16),
            frame.density.view(np.uint16),
            pack_camera(camera),
            camera.width,
            camera.height,
            near,
            thread_count(threads),
            simd_name(),
            order,
        )
        return order[:count]
