"""Prefetches frames in playback order, in a thread and within a memory limit."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice
from typing import Protocol

from fourd.base.errors import UserError
from fourd.scene import BakedFrame, SceneManifest
from fourd.scene.files.sound import OpusSound

BUFFER_BYTES = 384 << 20
MIN_FRAMES = 2
MAX_FRAMES = 32


class BakedFrameSource(Protocol):
    """Reads baked frames. A source is not thread-safe."""

    @property
    def manifest(self) -> SceneManifest:
        """The manifest of the scene."""

    def read(self, index: int) -> BakedFrame:
        """Read a frame. Reading can take a long time. Raises UserError if the frame is damaged."""

    def read_sound(self) -> OpusSound | None:
        """Return the sound, or None if there is none. Raises UserError if it is damaged."""

    def close(self) -> None:
        """Close files."""


class FramePrefetcher:
    """Returns buffered frames, and reads the next ones in a thread. Only one thread may call :meth:`get`."""

    def __init__(
        self, source: BakedFrameSource, buffer_bytes: int = BUFFER_BYTES, wanted_frames: int = MAX_FRAMES
    ) -> None:
        """The prefetcher takes ownership of ``source``, and :meth:`close` closes the source.

        ``buffer_bytes`` limits the memory of the buffered frames plus the source's background. At least two frames are
        buffered, even if they exceed the limit. Frames are read until the current frame and those that follow it are
        ``wanted_frames``; frames that have been read are kept.
        """
        self._source = source
        self._frame_count = source.manifest.frame_count
        self._wanted_frames = wanted_frames
        self._frame_bytes = buffer_bytes - source.manifest.background_nbytes
        self._changed = threading.Condition()
        self._buffer: dict[int, BakedFrame | UserError] = {}
        self._head, self._direction = 0, 1
        self._has_started = False
        self._largest: int | None = None  # Size in bytes of the largest frame read so far.
        self._generation = 0  # Number of calls of invalidate(), to drop frames whose reading began before such a call.
        self._is_stopped = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="frame reader", daemon=True)
        self._thread.start()

    def get(self, index: int, direction: int = 1, wait: bool = False) -> BakedFrame | None:
        """Return frame ``index``, and start to prefetch the next frames in ``direction``.

        While the frame is being read, the result is None or, if ``wait`` is True, the call waits for the frame.

        Raises UserError if the frame is damaged, and IndexError if the scene has no frame ``index``.
        """
        if not 0 <= index < self._frame_count:
            raise IndexError(f"frame: expected 0 to {self._frame_count - 1}, got {index}")
        with self._changed:
            self._head, self._direction, self._has_started = index, direction, True
            self._changed.notify_all()
            while wait and index not in self._buffer:
                self._raise_failure()
                self._changed.wait()
            self._raise_failure()
            found = self._buffer.get(index)
        if isinstance(found, UserError):
            # A new exception is raised each time, because raising the same one again would make its traceback grow.
            raise UserError(str(found))
        return found

    @property
    def frames_ahead(self) -> int:
        """Number of buffered frames that directly follow the current frame in playback order."""
        with self._changed:
            upcoming = self._playback_order()
            next(upcoming)
            missing = (count for count, index in enumerate(upcoming) if index not in self._buffer)
            return next(missing, self._frame_count - 1)

    def invalidate(self) -> None:
        """Read all frames again, because the source has changed."""
        with self._changed:
            self._buffer.clear()
            self._generation += 1
            self._changed.notify_all()

    def close(self) -> None:
        """Stop the thread and close the source."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()
        self._thread.join()
        self._buffer.clear()
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
        """Wait until a frame is needed, then read it. Returns False after :meth:`close`."""
        with self._changed:
            index = self._first_missing()
            while not self._is_stopped and index is None:
                self._changed.wait()
                index = self._first_missing()
            if self._is_stopped:
                return False
            generation = self._generation
        assert index is not None
        frame: BakedFrame | UserError
        try:
            frame = self._source.read(index)
        except UserError as error:
            frame = error
        with self._changed:
            if isinstance(frame, BakedFrame):
                self._largest = max(self._largest or 0, frame.nbytes)
            if generation == self._generation:
                self._buffer[index] = frame
            self._evict()
            self._changed.notify_all()
        return True

    def _first_missing(self) -> int | None:
        """Of the next frames in playback order that together fit into the memory limit, return the first one that is
        not buffered. Returns None if all of them are buffered, or if no frame has been requested yet."""
        if not self._has_started:
            return None
        upcoming = islice(self._playback_order(), min(self._capacity(), self._wanted_frames))
        return next((index for index in upcoming if index not in self._buffer), None)

    def _evict(self) -> None:
        keep = list(islice(self._playback_order(), self._capacity()))
        for index in [index for index in self._buffer if index not in keep]:
            del self._buffer[index]

    def _capacity(self) -> int:
        """Return the number of frames that fit into the memory limit.

        Each frame is assumed to be as large as the largest one read so far, so that evicting any frame makes room for
        any other.
        """
        if self._largest is None:
            return min(MIN_FRAMES, self._frame_count)
        fitting = self._frame_bytes // max(self._largest, 1)
        return min(max(MIN_FRAMES, fitting), MAX_FRAMES, self._frame_count)

    def _playback_order(self) -> Iterator[int]:
        """Yield the indices of all frames in playback order, starting at the current frame."""
        for step in range(self._frame_count):
            yield (self._head + self._direction * step) % self._frame_count
