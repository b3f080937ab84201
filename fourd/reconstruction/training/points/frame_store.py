"""Store the points of all frames in files, with a bounded memory cache."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

import torch
from cachetools import LRUCache
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from fourd.base.errors import UserError, one_line
from fourd.base.files import atomic_path
from fourd.base.limits import require_regular
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.scratch import Scratch
from fourd.rendering.ops.gpu import CPU


class FrameStore:
    """Points of all frames. Only the most recently used frames are kept in memory and the others are stored in files,
    so that memory use does not grow with the number of frames.

    On a CPU, one thread writes evicted points and reads the points that :meth:`prepare` names, while the caller works.
    The thread does this in the order of the calls, so the results do not depend on its speed."""

    def __init__(
        self,
        scratch: Scratch,
        frames: int,
        make: Callable[[int], FramePoints],
        memory_mb: int,
        saved: Path | None,
        device: torch.device = CPU,
    ) -> None:
        """Open a store.

        Args:
            scratch: folder to which points are written when they are evicted from memory.
            frames: number of frames.
            make: function that returns a frame's initial points, given the frame's index.
            memory_mb: maximum size of the points in memory, in MiB. The points of a single frame may exceed this size.
            saved: folder that :meth:`save` has written; the points are read from it. If None, initial points are used.
            device: device of the points that :meth:`get` returns.
        """
        self._scratch = scratch
        self._make = make
        self._saved = saved
        self._cache = _SpillingCache(memory_mb * 2**20, self._spill)
        self._spilled: set[int] = set()
        self._worker = ThreadPoolExecutor(1, "points")
        self._written: Future[None] | None = None
        self._ahead: tuple[int, Future[FramePoints]] | None = None
        self._device = device
        self.frames = frames

    @property
    def cached_count(self) -> int:
        """Number of frames whose points are in memory."""
        return len(self._cache)

    def get(self, frame: int) -> FramePoints:
        """Return the points of a frame. The caller may change them in place until the next call of this method; later
        changes may be lost."""
        ahead, self._ahead = self._ahead, None
        if frame not in self._cache:
            points = ahead[1].result() if ahead is not None and ahead[0] == frame else self._load(frame)
            self._cache[frame] = points
        return self._cache[frame]

    def prepare(self, frame: int) -> Callable[[], FramePoints] | None:
        """Start reading the points of a frame if they are stored in a file, so that the next call of :meth:`get` can
        return them at once. The points of the frame must not change before that call.

        Returns:
            a function that waits for the points and returns them, for reading only; any thread may call it. None if
            the points were never in memory, or if they are on a GPU.
        """
        if self._device.type != "cpu":
            return None
        if frame in self._cache:
            points = self._cache[frame]
            return lambda: points
        file = self._newest_file(frame)
        if file is None:
            return None
        self._ahead = frame, self._worker.submit(self._read, frame, file)
        return self._ahead[1].result

    def save(self, folder: Path, frames: Iterable[int] | None = None) -> None:
        """Write the points of the given frames, or of every frame, to ``folder``, one frame at a time."""
        self._settle()
        for frame in range(self.frames) if frames is None else frames:
            with atomic_path(folder / file_name(frame)) as temporary:
                self._write(frame, temporary)
        self._saved = folder

    def close(self) -> None:
        """Remove the scratch folder. Call this method when the store is no longer needed. If it is not called, the
        folder is removed when the object is deleted, and Python ignores a Ctrl-C during this deletion.
        """
        self._worker.shutdown()
        self._scratch.close()

    def _write(self, frame: int, target: Path) -> None:
        """Write a frame's points to ``target``. If they are not in memory, the newest file with them is copied."""
        file = self._newest_file(frame)
        if frame in self._cache:
            save_file(self._cache[frame].tensors(), target)
        elif file is None:
            save_file(self._make(frame).tensors(), target)
        else:
            shutil.copyfile(file, target)

    def _load(self, frame: int) -> FramePoints:
        self._settle()
        file = self._newest_file(frame)
        return self._make(frame).to(self._device).copy_outside_heap() if file is None else self._read(frame, file)

    def _read(self, frame: int, file: Path) -> FramePoints:
        named = load_points(file)
        if "spacing" not in named:  # the file was written by an older version of fourd
            named["spacing"] = self._make(frame).spacing
        return FramePoints.from_tensors(named).to(self._device).copy_outside_heap()

    def _settle(self) -> None:
        """Wait until the thread is idle. Raises UserError if evicted points could not be written."""
        wait([self._ahead[1]] if self._ahead is not None else [])
        written, self._written = self._written, None
        if written is not None:
            written.result()

    def _newest_file(self, frame: int) -> Path | None:
        """Return the newest file with the frame's points, or None if the frame was never written."""
        folder = self._scratch.folder if frame in self._spilled else self._saved
        return None if folder is None else folder / file_name(frame)

    def _spill(self, frame: int, points: FramePoints) -> None:
        """Write evicted points. At most one frame waits to be written, because it needs memory."""
        self._settle()
        file = self._scratch.folder / file_name(frame)
        self._spilled.add(frame)
        if self._device.type == "cpu":
            self._written = self._worker.submit(self._write_evicted, file, points)
        else:
            self._write_evicted(file, points)

    @staticmethod
    def _write_evicted(file: Path, points: FramePoints) -> None:
        try:
            save_file(points.tensors(), file)
        except (OSError, SafetensorError) as error:
            reason = one_line(error)
            raise UserError(
                f"{file}: expected free disk space for the points that do not fit in memory, got '{reason}'; "
                "free some space and add --resume"
            ) from error


def load_points(file: Path) -> dict[str, Tensor]:
    """Read the tensors of a file with points. Raises UserError if the file is missing or damaged."""
    try:
        require_regular(file)
        return load_file(file)
    except (OSError, SafetensorError) as error:
        reason = one_line(error)
        raise UserError(
            f"{file}: expected the points of a checkpoint, got a file that cannot be read ({reason}); "
            "delete the checkpoint to use the previous one"
        ) from error


class _SpillingCache(LRUCache[int, FramePoints]):
    """Least-recently-used cache that calls ``spill`` with the points that it evicts."""

    def __init__(self, max_bytes: int, spill: Callable[[int, FramePoints], None]) -> None:
        # cachetools raises an error for a value that is larger than the whole cache.
        super().__init__(max_bytes, getsizeof=lambda points: min(points.nbytes, max_bytes))
        self._spill = spill

    def popitem(self) -> tuple[int, FramePoints]:
        frame, points = super().popitem()
        self._spill(frame, points)
        return frame, points


def file_name(frame: int) -> str:
    """Return the name of the file with a frame's points."""
    return f"{frame:06d}.safetensors"
