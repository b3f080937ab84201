"""Points of all frames, in a cache of bounded size over files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from cachetools import LRUCache
from safetensors.torch import load_file, save_file

from fourd.files import atomic_path
from fourd.training.points.frame_points import FramePoints
from fourd.training.points.scratch import Scratch


class FrameStore:
    """Points of all frames; frames out of use are in files, so that memory does not grow with the frame count."""

    def __init__(
        self, scratch: Scratch, frames: int, make: Callable[[int], FramePoints], memory_mb: int, saved: Path | None
    ) -> None:
        """Open a store.

        Args:
            scratch: holds points that leave memory between checkpoints.
            frames: number of frames.
            make: gives the initial points of a frame.
            memory_mb: bound on the points in memory; one frame's points may exceed it.
            saved: a folder written by :meth:`save`, from which points are read.
        """
        self._scratch = scratch
        self._make = make
        self._saved = saved
        self._cache = _SpillingCache(memory_mb * 2**20, self._spill)
        self._spilled: set[int] = set()
        self.frames = frames

    @property
    def cached_count(self) -> int:
        """Number of frames in memory."""
        return len(self._cache)

    def get(self, frame: int) -> FramePoints:
        """The points of a frame; changes in place are kept if they are made before the next call."""
        if frame not in self._cache:
            self._cache[frame] = self._load(frame).copy_outside_heap()
        return self._cache[frame]

    def save(self, folder: Path) -> None:
        """Write every frame below ``folder``, one at a time."""
        for frame in range(self.frames):
            with atomic_path(folder / _file_name(frame)) as temporary:
                self._write(frame, temporary)
        self._saved = folder

    def _write(self, frame: int, target: Path) -> None:
        """Write the points in memory, or copy the newest file without reading it."""
        file = self._newest_file(frame)
        if frame in self._cache:
            save_file(self._cache[frame].tensors(), target)
        elif file is None:
            save_file(self._make(frame).tensors(), target)
        else:
            shutil.copyfile(file, target)

    def _load(self, frame: int) -> FramePoints:
        file = self._newest_file(frame)
        if file is None:
            return self._make(frame)
        named = load_file(file)
        if "spacing" not in named:  # a file of an older version
            named["spacing"] = self._make(frame).spacing
        return FramePoints.from_tensors(named)

    def _newest_file(self, frame: int) -> Path | None:
        """The file with the frame's points; None for a frame that was never written."""
        folder = self._scratch.folder if frame in self._spilled else self._saved
        return None if folder is None else folder / _file_name(frame)

    def _spill(self, frame: int, points: FramePoints) -> None:
        save_file(points.tensors(), self._scratch.folder / _file_name(frame))
        self._spilled.add(frame)


class _SpillingCache(LRUCache[int, FramePoints]):
    """Least-recently-used cache that hands evicted points to ``spill``."""

    def __init__(self, max_bytes: int, spill: Callable[[int, FramePoints], None]) -> None:
        # A value larger than the cache is an error to cachetools.
        super().__init__(max_bytes, getsizeof=lambda points: min(points.nbytes, max_bytes))
        self._spill = spill

    def popitem(self) -> tuple[int, FramePoints]:
        frame, points = super().popitem()
        self._spill(frame, points)
        return frame, points


def _file_name(frame: int) -> str:
    return f"{frame:06d}.safetensors"
