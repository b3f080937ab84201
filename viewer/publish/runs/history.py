"""Reads the measurements of a run from ``metrics.jsonl``, to which training may still append."""

from __future__ import annotations

import json
import math
import os
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.limits import open_regular
from fourd.reconstruction.training.metrics_log import METRICS_NAME

MAX_LINE_BYTES = 1 << 16
MAX_READ_BYTES = 16 << 20
"""Maximum number of bytes that one call of :meth:`RunHistory.update` reads."""
MAX_SERIES = 64
MAX_NAME = 64
"""Maximum number of characters in the name of a series."""
MAX_STEP = 1 << 53
_BINS = 300


@dataclass
class Series:
    """The values of one measurement, in the order of the log."""

    steps: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))


class RunHistory:
    """The measurements in the log of a training run, as one series per measurement. The log grows during training. When
    the run is resumed, training may replace the log with a shorter one.

    Attributes:
        series: the values by name. Values that are not finite numbers are left out.
        broken: number of lines in the log that are not valid records.
    """

    def __init__(self, run: Path) -> None:
        self.series: dict[str, Series] = {}
        self.broken = 0
        self._path = run / METRICS_NAME
        self._reset()

    def _reset(self) -> None:
        self.series, self.broken = {}, 0
        self._file = (0, 0)
        self._offset = 0
        self._is_skipping = False

    def update(self) -> None:
        """Read the complete lines that were added to the log since the last call. A log that cannot be read counts as
        empty."""
        try:
            stream = open_regular(self._path)
        except (OSError, UserError):
            self._reset()
            return
        with stream:
            status = os.fstat(stream.fileno())
            file = (status.st_dev, status.st_ino)
            if file != self._file or status.st_size < self._offset:
                self._reset()
                self._file = file
            stream.seek(self._offset)
            content = stream.read(MAX_READ_BYTES)
        *lines, rest = content.split(b"\n")
        self._offset += len(content) - len(rest)
        for line in lines:
            if self._is_skipping or len(line) > MAX_LINE_BYTES:
                self.broken += 1
            else:
                self._add(line)
            self._is_skipping = False
        if len(rest) > MAX_LINE_BYTES:
            # The line is too long to be a record. Its start is skipped, so that the next call does not read it again.
            self._offset += len(rest)
            self._is_skipping = True

    def last(self, name: str) -> float | None:
        """Return the last value of a series, or None if it has no values."""
        found = self.series.get(name)
        return found.values[-1] if found is not None and found.values else None

    @property
    def step(self) -> int:
        """The largest training step in the log, or 0 if the log has no measurements."""
        return max((found.steps[-1] for found in self.series.values() if found.steps), default=0)

    def curves(self) -> dict[str, dict[str, list[float]]]:
        """Return each series as the lists ``step`` and ``value``, with at most a few hundred entries.

        A longer series is divided into bins, and the steps and the values of each bin are averaged. Half of the bin
        edges are evenly spaced, for detail on linear axes. The others are spaced geometrically, for detail on
        logarithmic axes.
        """
        return {name: _binned(found) for name, found in sorted(self.series.items())}

    def _add(self, line: bytes) -> None:
        try:
            record = json.loads(line)
        except (ValueError, RecursionError):
            record = None
        step = record.get("step") if isinstance(record, dict) else None
        if type(step) is not int or not 0 <= step < MAX_STEP:
            self.broken += 1
            return
        for name, value in _numbers(record).items():
            found = self.series.get(name)
            if found is None:
                if len(self.series) >= MAX_SERIES:
                    continue
                found = self.series[name] = Series()
            found.steps.append(step)
            found.values.append(value)


def _numbers(record: Mapping[str, Any]) -> dict[str, float]:
    """Return the finite numbers of a record (one line of the log) by name. The step, and numbers whose name has more
    than MAX_NAME characters, are left out."""
    return {
        name: float(value)
        for name, value in record.items()
        if name != "step" and len(name) <= MAX_NAME and type(value) in (int, float) and _is_finite(value)
    }


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # the number is an integer above the largest float
        return False


def _binned(series: Series) -> dict[str, list[float]]:
    steps, values = np.array(series.steps, np.float64), np.array(series.values, np.float64)
    if len(steps) > 2 * _BINS:
        linear = np.linspace(0, len(steps), _BINS + 1)
        growing = np.geomspace(1, len(steps), _BINS + 1)
        edges = np.unique(np.concatenate([linear, growing]).astype(np.int64))[:-1]
        counts = np.diff(np.append(edges, len(steps)))
        steps, values = (np.add.reduceat(each, edges) / counts for each in (steps, values))
    return {"step": _rounded(steps), "value": _rounded(values)}


def _rounded(values: NDArray[np.float64]) -> list[float]:
    """Round the values to seven significant digits."""
    return [float(f"{value:.7g}") for value in values]
