"""Timings that are comparable on a machine under varying load.

A timing is a median of several runs, in milliseconds and relative to the time of a fixed computation, the unit.
"""

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
    """Median time of several runs. Before every timed run of the work, the unit, a fixed computation, is timed.

    Attributes:
        ms: median time of the work in milliseconds.
        units: median of the ratios of the work's time to the unit's time. The unit is torch's product of two 2048 x
            2048 float32 matrices.
        runs: number of timed runs of the work.
    """

    ms: float
    units: float
    runs: int


class Clock:
    """Times a function in rounds. Each round also times the unit."""

    def __init__(self, seconds: float, min_runs: int = 3, max_runs: int = 50) -> None:
        """``seconds`` is the approximate sum of the timed runs of one function.

        It determines the number of timed runs, which is limited to ``min_runs`` to ``max_runs``.
        """
        generator = torch.Generator().manual_seed(0)
        self._square = torch.randn(UNIT_SIDE, UNIT_SIDE, generator=generator)
        self._seconds = seconds
        self._min_runs = min_runs
        self._max_runs = max_runs

    def time(self, work: Work, repeats: int = 1) -> Timing:
        """Time ``work`` after one warm-up run.

        ``work`` runs its computation ``repeats`` times; results are per repeat.
        """
        first = _time_ms(work)
        runs = max(self._min_runs, min(self._max_runs, int(1000 * self._seconds / max(first, 0.1))))
        units, times = [], []
        for _ in range(runs):
            units.append(_time_ms(lambda: self._square @ self._square))
            # Untimed run: the OpenMP threads of the matrix product still spin and would slow down the timed run.
            work()
            times.append(_time_ms(work) / repeats)
        ratios = [one / unit for one, unit in zip(times, units, strict=True)]
        return Timing(statistics.median(times), statistics.median(ratios), runs)


def _time_ms(work: Work) -> float:
    started = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - started)
