"""Times that can be compared although the machine is shared: medians, paired with a unit of work."""

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
    """Medians of several runs, each next to one of the unit.

    Attributes:
        ms: of the work.
        units: of the work's time over the unit's in the same round; the unit is a matrix product of
            2048 x 2048 float32 by torch.
        runs: how many.
    """

    ms: float
    units: float
    runs: int


class Clock:
    """Times work in rounds, each with the unit beside it."""

    def __init__(self, seconds: float, least: int = 3, most: int = 50) -> None:
        """``seconds`` is about how long one kind of work is timed; it runs ``least`` to ``most`` times."""
        generator = torch.Generator().manual_seed(0)
        self._square = torch.randn(UNIT_SIDE, UNIT_SIDE, generator=generator)
        self._seconds = seconds
        self._least = least
        self._most = most

    def time(self, work: Work, parts: int = 1) -> Timing:
        """Time ``work``, which is run once before to warm up, as a mean of the ``parts`` that it does."""
        first = _ms(work)
        runs = max(self._least, min(self._most, int(1000 * self._seconds / max(first, 0.1))))
        units, times = [], []
        for _ in range(runs):
            units.append(_ms(lambda: self._square @ self._square))
            # The product's threads spin for a while after it, and would slow the first run of what follows.
            work()
            times.append(_ms(work) / parts)
        ratios = [one / unit for one, unit in zip(times, units, strict=True)]
        return Timing(statistics.median(times), statistics.median(ratios), runs)


def _ms(work: Work) -> float:
    started = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - started)
