"""Sorts points by depth, either on request or in a background thread."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene import BakedFrame
from fourd.scene.depth_order import DepthSorter
from fourd.viewer.display import RenderRequest


@dataclass(frozen=True, eq=False)
class DepthOrder:
    """The indices of a frame's points, sorted by depth.

    Attributes:
        frame: the frame that contains the points.
        camera: the camera that defines depth.
        points: indices of the visible points, nearest first.
        seconds: duration of the sort in seconds.
    """

    frame: BakedFrame
    camera: Camera
    points: NDArray[np.uint32]
    seconds: float

    def matches(self, request: RenderRequest) -> bool:
        """Return True if this order was computed for the request's frame object and camera object."""
        return self.frame is request.frame and self.camera is request.camera


class DepthOrders(Protocol):
    """Supplies a depth order for each request."""

    def order(self, request: RenderRequest, wait: bool) -> DepthOrder:
        """Return a depth order for ``request``.

        If ``wait`` is True, the depth order is computed for ``request``. If ``wait`` is False, the result may be the
        depth order of an earlier request.
        """

    def release(self) -> None:
        """Stop the work in background threads."""


class ExactOrders:
    """Sorts the points for each request. If the frame and the camera have not changed, the last order is reused."""

    def __init__(self) -> None:
        self._sorter = DepthSorter()
        self._last: DepthOrder | None = None

    def order(self, request: RenderRequest, wait: bool) -> DepthOrder:
        """Return the depth order of ``request``."""
        if self._last is None or not self._last.matches(request):
            started = time.perf_counter()
            points = self._sorter.sort(request.frame, request.camera, request.manifest.near)
            self._last = DepthOrder(request.frame, request.camera, points, time.perf_counter() - started)
        return self._last

    def release(self) -> None:
        """Discard the last depth order."""
        self._last = None


class BackgroundOrders:
    """Sorts the points of the newest request in a thread.

    :meth:`order` may return the depth order of an earlier request, made for a different camera pose. To include points
    that have entered the image since, the thread sorts all points inside an image of twice the width and height.
    """

    def __init__(self) -> None:
        self._sorter = DepthSorter()
        self._changed = threading.Condition()
        self._newest: RenderRequest | None = None
        self._order: DepthOrder | None = None
        self._failure: BaseException | None = None
        self._is_stopped = False
        self._thread = threading.Thread(target=self._run, name="depth order", daemon=True)
        self._thread.start()

    def order(self, request: RenderRequest, wait: bool) -> DepthOrder:
        """Return the newest depth order. If ``wait`` is True, wait for the depth order of ``request`` and return it.

        The first call always waits until a depth order exists. Raises RuntimeError if sorting has failed.
        """
        with self._changed:
            self._newest = request
            self._changed.notify_all()
            while True:
                if self._failure is not None:
                    raise RuntimeError("the points cannot be sorted") from self._failure
                if self._is_stopped:
                    raise RuntimeError("the sorting thread has stopped")
                if self._order is not None and (self._order.matches(request) or not wait):
                    return self._order
                self._changed.wait()

    def release(self) -> None:
        """Stop the thread."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()
        self._thread.join()
        self._order = self._newest = None

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._is_stopped and not self._has_work():
                    self._changed.wait()
                if self._is_stopped:
                    return
                request = self._newest
            assert request is not None
            try:
                order = self._sort(request)
            except BaseException as error:
                with self._changed:
                    self._failure = error
                    self._changed.notify_all()
                raise
            with self._changed:
                self._order = order
                self._changed.notify_all()

    def _has_work(self) -> bool:
        return self._newest is not None and (self._order is None or not self._order.matches(self._newest))

    def _sort(self, request: RenderRequest) -> DepthOrder:
        started = time.perf_counter()
        camera = request.camera
        wider = camera.crop(-(camera.width // 2), -(camera.height // 2), 2 * camera.width, 2 * camera.height)
        points = self._sorter.sort(request.frame, wider, request.manifest.near / 2)
        return DepthOrder(request.frame, camera, points, time.perf_counter() - started)
