"""Frames read ahead of the one that is shown, by a thread, into bounded memory."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice
from typing import Protocol

from fourd.baking import BakedFrame, SceneManifest
from fourd.errors import UserError

RING_BYTES = 384 << 20
_LEAST = 2
_MOST = 32


class BakedFrameSource(Protocol):
    """Where frames come from; read by one thread at a time."""

    @property
    def manifest(self) -> SceneManifest:
        """What holds for all frames."""

    def read(self, index: int) -> BakedFrame:
        """A frame's arrays; slow. Raises UserError when it is damaged."""

    def close(self) -> None:
        """Let go of files."""


class FramePrefetcher:
    """Gives frames that are there, and reads those that come next. Frames are asked for by one thread."""

    def __init__(self, source: BakedFrameSource, ring_bytes: int = RING_BYTES) -> None:
        """Takes ``source`` over and closes it.

        The frames kept fit ``ring_bytes`` together with a background, which the source keeps, but are at least two.
        """
        self._source = source
        self._frames = source.manifest.frame_count
        self._room = ring_bytes - source.manifest.background_nbytes
        self._changed = threading.Condition()
        self._ring: dict[int, BakedFrame | UserError] = {}
        self._head, self._direction = 0, 1
        self._wants = False
        self._largest: int | None = None  # bytes of a frame
        self._age = 0  # of what is read: frames of an older one are dropped when they come
        self._stopped = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="frame reader", daemon=True)
        self._thread.start()

    def get(self, index: int, direction: int = 1, wait: bool = False) -> BakedFrame | None:
        """A frame, or None while it is being read; those after it in ``direction`` are read ahead.

        Raises UserError when the file is damaged there, IndexError outside the scene.
        """
        if not 0 <= index < self._frames:
            raise IndexError(f"frame: expected 0 to {self._frames - 1}, got {index}")
        with self._changed:
            self._head, self._direction, self._wants = index, direction, True
            self._changed.notify_all()
            while wait and index not in self._ring:
                self._raise_failure()
                self._changed.wait()
            self._raise_failure()
            found = self._ring.get(index)
        if isinstance(found, UserError):
            raise UserError(str(found))  # a new one: each time that one is raised, it keeps more of its callers
        return found

    @property
    def ahead(self) -> int:
        """How many frames after the one asked for last are there without a gap."""
        with self._changed:
            wanted = self._after(self._head, self._direction)
            next(wanted)
            return next((count for count, index in enumerate(wanted) if index not in self._ring), self._frames - 1)

    def forget(self) -> None:
        """Read everything again: the source has changed."""
        with self._changed:
            self._ring.clear()
            self._age += 1
            self._changed.notify_all()

    def close(self) -> None:
        """Stop reading and close the source."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()
        self._ring.clear()
        self._source.close()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            while self._read_next():
                pass
        except BaseException as error:
            with self._changed:
                self._failure = error
                self._changed.notify_all()

    def _read_next(self) -> bool:
        with self._changed:
            wanted = self._wanted()
            while not self._stopped and wanted is None:
                self._changed.wait()
                wanted = self._wanted()
            if self._stopped:
                return False
            age = self._age
        assert wanted is not None
        frame: BakedFrame | UserError
        try:
            frame = self._source.read(wanted)
        except UserError as error:
            frame = error
        with self._changed:
            if isinstance(frame, BakedFrame):
                self._largest = max(self._largest or 0, frame.nbytes)
            if age == self._age:
                self._ring[wanted] = frame
            self._drop()
            self._changed.notify_all()
        return True

    def _wanted(self) -> int | None:
        """The first frame that should be there and is not."""
        if not self._wants:
            return None
        coming = islice(self._after(self._head, self._direction), self._capacity())
        return next((index for index in coming if index not in self._ring), None)

    def _drop(self) -> None:
        keep = list(islice(self._after(self._head, self._direction), self._capacity()))
        for index in [index for index in self._ring if index not in keep]:
            del self._ring[index]

    def _capacity(self) -> int:
        """How many frames fit if all were as large as the largest so far: dropping that makes no new room."""
        if self._largest is None:
            return min(_LEAST, self._frames)
        return min(max(_LEAST, self._room // max(self._largest, 1)), _MOST, self._frames)

    def _after(self, head: int, direction: int) -> Iterator[int]:
        """All frames in the order in which they are played."""
        for step in range(self._frames):
            yield (head + direction * step) % self._frames
