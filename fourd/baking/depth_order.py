"""A frame's points in order of depth, for renderers that draw them over each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame
from fourd.cameras import Camera
from fourd.ops.play.op import PointSorter


class DepthSorter:
    """Sorts frames' points by depth; keeps its workspace between calls. Threads may share it; they take turns."""

    def __init__(self) -> None:
        """Raises ImportError if the native module is not built."""
        self._points = PointSorter()

    def sort(self, frame: BakedFrame, camera: Camera, near: float, *, threads: int = 0) -> NDArray[np.uint32]:
        """Return the indices of the points that ``camera`` sees, nearest first, ties by index.

        See :meth:`fourd.ops.play.op.PointSorter.sort` for the points that are left out, the arguments and the errors.
        ``frame`` has finite radii and densities, as :class:`fourd.baking.container.SceneReader` guarantees.
        """
        return self._points.sort(frame.xyz, frame.radius, frame.density, camera, near, threads=threads)
