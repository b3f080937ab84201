"""What a run measured, step by step: metrics.jsonl for programs, TensorBoard events for eyes."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.errors import UserError
from fourd.files import atomic_path

METRICS_NAME = "metrics.jsonl"
FLUSH_SECONDS = 10


class MetricsLog:
    """Appends to ``metrics.jsonl`` and to TensorBoard events in a run folder; usable in a ``with``."""

    def __init__(self, folder: Path, resume_step: int = 0) -> None:
        """Open the log of a run, dropping what lies after the step that is gone on from.

        Args:
            folder: the run's folder; made when absent.
            resume_step: steps already done. Lines of later steps, and lines that a kill left
                half written, are removed; TensorBoard is told to hide the same steps.

        Raises:
            UserError: the folder cannot be written to.
        """
        # The import takes a second, so it waits until a log is opened.
        from torch.utils.tensorboard import SummaryWriter

        self._folder = folder
        path = folder / METRICS_NAME
        with self._reported():
            folder.mkdir(parents=True, exist_ok=True)
            if path.exists():
                _truncate(path, resume_step)
            self._stream = path.open("a", encoding="utf-8")
            purge = resume_step + 1 if resume_step > 0 else None
            self._events = SummaryWriter(str(folder), purge_step=purge, flush_secs=FLUSH_SECONDS)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Write one record ``{"step": step, **values}``; values that are not finite become null.

        Raises UserError when the disk is full.
        """
        record: dict[str, float | int | None] = {"step": int(step)}
        for name, value in values.items():
            record[name] = float(value) if math.isfinite(value) else None
        with self._reported():
            self._stream.write(json.dumps(record, allow_nan=False) + "\n")
            self._stream.flush()
            for name, value in values.items():
                self._events.add_scalar(name, value, step)

    def image(self, step: int, name: str, picture: NDArray[np.uint8]) -> None:
        """Show a picture (H, W, 3), uint8 RGB, in TensorBoard. Raises UserError when the disk is full."""
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ValueError(f"picture: expected (H, W, 3) of uint8, got {picture.shape} of {picture.dtype}")
        with self._reported():
            self._events.add_image(name, picture, step, dataformats="HWC")

    def close(self) -> None:
        """Write out what is held back; calling it again does nothing. Raises UserError when the disk is full."""
        if self._stream.closed:
            return
        with self._reported():
            self._stream.close()
            self._events.close()

    def __enter__(self) -> MetricsLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise UserError(
                f"{self._folder}: expected a folder that metrics can be written to, got '{error.strerror or error}'; "
                f"free some space or mend its permissions, and add --resume"
            ) from error


def _truncate(path: Path, last_step: int) -> None:
    """Keep the whole records up to ``last_step``, line by line, since a long run's file is large."""
    with path.open("rb") as lines, atomic_path(path) as temporary, temporary.open("wb") as kept:
        for line in lines:
            if line.endswith(b"\n") and _step_of(line) <= last_step:
                kept.write(line)


def _step_of(line: bytes) -> float:
    """A record's step; infinite for what is no record, which is dropped thereby."""
    try:
        record = json.loads(line)
    except ValueError:
        return math.inf
    step = record.get("step") if isinstance(record, dict) else None
    return step if isinstance(step, int) else math.inf
