"""Sorting a frame's points by depth, for renderers that blend points in depth order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.play.op import PointSorter
from fourd.scene.scene import BakedFrame


class DepthSorter:
    """Sorts the points of frames by depth and reuses its workspace between calls.

    Several threads may use one instance, because a lock serializes their calls.
    """

    def __init__(self) -> None:
        """Raises ImportError if the native module is not built."""
        self._points = PointSorter()

    def sort(self, frame: BakedFrame, camera: Camera, near: float, *, threads: int = 0) -> NDArray[np.uint32]:
        """Return the indices of the points that lie in the image of ``camera``, sorted from near to far. Points of
        equal depth are ordered by index.

        See :meth:`fourd.rendering.ops.play.op.PointSorter.sort` for the arguments, the errors and the points that are
        omitted. The radii and densities of ``frame`` must be finite; :class:`fourd.scene.container.SceneReader` checks
        this.
        """
        return self._points.sort(frame.xyz, frame.radius, frame.density, camera, near, threads=threads)
