"""Orders of points by depth: at once, or from a background thread."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.baking import BakedFrame
from fourd.baking.depth_order import DepthSorter
from fourd.cameras import Camera
from fourd.viewer.display import RenderRequest


@dataclass(frozen=True, eq=False)
class Order:
    """Points of a frame as a camera ordered them.

    Attributes:
        frame: whose points they are.
        camera: that ordered them.
        points: indices, nearest first.
        seconds: what the sorting took.
    """

    frame: BakedFrame
    camera: Camera
    points: NDArray[np.uint32]
    seconds: float

    def fits(self, request: RenderRequest) -> bool:
        """Whether it is the request's own: of the same frame and camera, as objects."""
        return self.frame is request.frame and self.camera is request.camera


class Orders(Protocol):
    """Gives an order for a request."""

    def order(self, request: RenderRequest, wait: bool) -> Order:
        """An order that fits the request; with ``wait``, exactly its."""

    def release(self) -> None:
        """Stop what goes on in the background."""


class ExactOrders:
    """Sorts when asked, unless the frame and the camera are those of the time before."""

    def __init__(self) -> None:
        self._sorter = DepthSorter()
        self._last: Order | None = None

    def order(self, request: RenderRequest, wait: bool) -> Order:
        if self._last is None or not self._last.fits(request):
            started = time.perf_counter()
            points = self._sorter.sort(request.frame, request.camera, request.manifest.near)
            self._last = Order(request.frame, request.camera, points, time.perf_counter() - started)
        return self._last

    def release(self) -> None:
        self._last = None


class BackgroundOrders:
    """Sorts in a thread: the order drawn may be that of a camera, or of a frame, a little older.

    The thread always takes the newest request. Its camera looks wider than the picture, so that
    points that come into sight before the next order are there.
    """

    def __init__(self) -> None:
        self._sorter = DepthSorter()
        self._changed = threading.Condition()
        self._wanted: RenderRequest | None = None
        self._done: Order | None = None
        self._failure: BaseException | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="depth order", daemon=True)
        self._thread.start()

    def order(self, request: RenderRequest, wait: bool) -> Order:
        with self._changed:
            self._wanted = request
            self._changed.notify_all()
            while True:
                if self._failure is not None:
                    raise RuntimeError("the points cannot be sorted") from self._failure
                if self._stopped:
                    raise RuntimeError("the sorting has been stopped")
                if self._done is not None and (self._done.fits(request) or not wait):
                    return self._done
                self._changed.wait()

    def release(self) -> None:
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()
        self._done = self._wanted = None

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._stopped and not self._work():
                    self._changed.wait()
                if self._stopped:
                    return
                request = self._wanted
            assert request is not None
            try:
                done = self._sorted(request)
            except BaseException as error:
                with self._changed:
                    self._failure = error
                    self._changed.notify_all()
                raise
            with self._changed:
                self._done = done
                self._changed.notify_all()

    def _work(self) -> bool:
        """Whether the newest request still lacks its order."""
        return self._wanted is not None and (self._done is None or not self._done.fits(self._wanted))

    def _sorted(self, request: RenderRequest) -> Order:
        started = time.perf_counter()
        camera = request.camera
        wider = camera.crop(-(camera.width // 2), -(camera.height // 2), 2 * camera.width, 2 * camera.height)
        points = self._sorter.sort(request.frame, wider, request.manifest.near / 2)
        return Order(request.frame, camera, points, time.perf_counter() - started)
