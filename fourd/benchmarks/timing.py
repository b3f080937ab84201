"""Timings that are comparable although the machine is shared: medians, paired with a unit of work."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch

Work = Callable[[], object]
UNIT_SIDE = 2048


@dataclass(frozen=True)
class Timing:
    """Medians of several runs, each paired with a run of the unit.

    Attributes:
        ms: time of the work.
        units: ratio of the work's time to the unit's in the same round. The unit is a 2048 x 2048 float32 matrix
            product by torch.
        runs: number of runs.
    """

    ms: float
    units: float
    runs: int


class Clock:
    """Times work in rounds, each paired with a run of the unit."""

    def __init__(self, seconds: float, min_runs: int = 3, max_runs: int = 50) -> None:
        """``seconds`` is the approximate time to spend on one work, within the limits on its runs."""
        generator = torch.Generator().manual_seed(0)
        self._square = torch.randn(UNIT_SIDE, UNIT_SIDE, generator=generator)
        self._seconds = seconds
        self._min_runs = min_runs
        self._max_runs = max_runs

    def time(self, work: Work, repeats: int = 1) -> Timing:
        """Time ``work`` after one warm-up run. A work that repeats itself is reported per repeat."""
        first = _time_ms(work)
        runs = max(self._min_runs, min(self._max_runs, int(1000 * self._seconds / max(first, 0.1))))
        units, times = [], []
        for _ in range(runs):
            units.append(_time_ms(lambda: self._square @ self._square))
            # The product's threads spin for a while afterwards and would slow down the first run after it.
            work()
            times.append(_time_ms(work) / repeats)
        ratios = [one / unit for one, unit in zip(times, units, strict=True)]
        return Timing(statistics.median(times), statistics.median(ratios), runs)


def _time_ms(work: Work) -> float:
    started = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - started)
