"""Timings that are comparable on a machine under varying load.

A timing is the median over several runs, in milliseconds and as a multiple of the time of a fixed computation, which is
called the unit.
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
    """Median time of several runs. A fixed computation, the unit, is timed before every timed run of the work.

    Attributes:
        ms: median time of the work in milliseconds.
        units: median of the ratios of the work's time to the unit's time. The unit is the product of two 2048 x 2048
            float32 matrices in torch.
        runs: number of timed runs of the work.
    """

    ms: float
    units: float
    runs: int


class Clock:
    """Times functions. Before every timed run of a function, the clock also times a fixed computation, the unit (see
    :class:`Timing`)."""

    def __init__(self, seconds: float, min_runs: int = 3, max_runs: int = 50) -> None:
        """Choose how long each function is timed.

        ``seconds`` is the approximate total time of the timed runs of one function. Their number is at least
        ``min_runs`` and at most ``max_runs``.
        """
        generator = torch.Generator().manual_seed(0)
        self._square = torch.randn(UNIT_SIDE, UNIT_SIDE, generator=generator)
        self._seconds = seconds
        self._min_runs = min_runs
        self._max_runs = max_runs

    def time(self, work: Work, repeats: int = 1) -> Timing:
        """Time ``work`` after one warm-up run.

        One call of ``work`` must repeat its computation ``repeats`` times. The measured time of a call is divided by
        ``repeats``.
        """
        first = _time_ms(work)
        runs = max(self._min_runs, min(self._max_runs, int(1000 * self._seconds / max(first, 0.1))))
        units, times = [], []
        for _ in range(runs):
            units.append(_time_ms(lambda: self._square @ self._square))
            # The first run is not timed, because the OpenMP threads of the matrix product above still spin and slow it
            # down.
            work()
            times.append(_time_ms(work) / repeats)
        ratios = [one / unit for one, unit in zip(times, units, strict=True)]
        return Timing(statistics.median(times), statistics.median(ratios), runs)


def _time_ms(work: Work) -> float:
    started = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - started)
