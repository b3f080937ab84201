"""Log a run's measurements to metrics.jsonl, which is easy to parse, and to TensorBoard events."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.base.limits import open_regular, require_regular

METRICS_NAME = "metrics.jsonl"
FLUSH_SECONDS = 10


class NoLog:
    """A log that writes nothing, with the methods of :class:`MetricsLog`."""

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Do nothing."""

    def image(self, step: int, name: str, picture: NDArray[np.uint8]) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class MetricsLog:
    """A context manager that appends to ``metrics.jsonl`` and to TensorBoard events in a run folder."""

    def __init__(self, folder: Path, resume_step: int = 0) -> None:
        """Open the log of a run, and remove the records of steps after the one from which the run resumes.

        Args:
            folder: the run's folder; created if missing.
            resume_step: number of completed steps of the checkpoint from which the run resumes. Records of later steps
                are removed, as are incomplete lines left by a killed process. TensorBoard events of later steps remain
                in their file, but TensorBoard does not show them.

        Raises:
            UserError: the folder is not writable.
        """
        # Importing TensorBoard takes about a second, so it is imported only when a log is opened.
        from torch.utils.tensorboard import SummaryWriter

        self._folder = folder
        path = folder / METRICS_NAME
        with self._os_errors_as_user_errors():
            folder.mkdir(parents=True, exist_ok=True)
            require_regular(path)
            if path.exists():
                _truncate(path, resume_step)
            self._stream = path.open("a", encoding="utf-8")
            self._hook = threading.excepthook
            threading.excepthook = self._ignore_disk_errors
            purge = resume_step + 1 if resume_step > 0 else None
            self._events = SummaryWriter(str(folder), purge_step=purge, flush_secs=FLUSH_SECONDS)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Write one record ``{"step": step, **values}``. NaN and infinity are written as null.

        Raises UserError if the disk is full.
        """
        record: dict[str, float | int | None] = {"step": int(step)}
        for name, value in values.items():
            record[name] = float(value) if math.isfinite(value) else None
        with self._os_errors_as_user_errors():
            self._stream.write(json.dumps(record, allow_nan=False) + "\n")
            self._stream.flush()
            for name, value in values.items():
                self._events.add_scalar(name, value, step)

    def image(self, step: int, name: str, picture: NDArray[np.uint8]) -> None:
        """Write an image (H, W, 3) in uint8 RGB to the TensorBoard events. Raises UserError if the disk is full."""
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ValueError(f"picture: expected uint8 (H, W, 3), got {picture.dtype} {picture.shape}")
        with self._os_errors_as_user_errors():
            self._events.add_image(name, picture, step, dataformats="HWC")

    def close(self) -> None:
        """Flush and close the log. Closing the log again has no effect. Raises UserError if the disk is full."""
        if self._stream.closed:
            return
        threading.excepthook = self._hook
        with self._os_errors_as_user_errors():
            self._stream.close()
            self._events.close()

    def __enter__(self) -> MetricsLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ignore_disk_errors(self, arguments: threading.ExceptHookArgs) -> None:
        """Suppress the traceback if TensorBoard's background thread cannot write. The error is not lost, because the
        next TensorBoard call raises it again."""
        if not (arguments.exc_type is not None and issubclass(arguments.exc_type, OSError | MemoryError)):
            self._hook(arguments)

    @contextmanager
    def _os_errors_as_user_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise UserError(
                f"{self._folder}: expected a writable folder for metrics, got '{error.strerror or error}'; "
                f"free some space or make the folder writable, and add --resume"
            ) from error


def _truncate(path: Path, last_step: int) -> None:
    """Remove incomplete lines and all records after step ``last_step``.

    The file is processed line by line, because the log of a long run is large.
    """
    with open_regular(path) as lines, atomic_path(path) as temporary, temporary.open("wb") as kept:
        for line in lines:
            if line.endswith(b"\n") and _step_of(line) <= last_step:
                kept.write(line)


def _step_of(line: bytes) -> float:
    """Return the step of the record in a line, or infinity if the line is not a record."""
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return math.inf
    step = record.get("step") if isinstance(record, dict) else None
    return step if isinstance(step, int) else math.inf
