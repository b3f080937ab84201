"""Where a picture's time goes, for the plot."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

PARTS = ("draw", "panel", "show")
KEPT = 120


class Timings:
    """Milliseconds of the last pictures by part."""

    def __init__(self) -> None:
        self._history = np.zeros((KEPT, len(PARTS)))
        self._now = dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Time a part of the picture that is being made."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self._now[name] += 1e3 * (time.perf_counter() - started)

    def finish(self) -> None:
        """The picture is done."""
        self._history = np.roll(self._history, -1, axis=0)
        self._history[-1] = [self._now[name] for name in PARTS]
        self._now = dict.fromkeys(PARTS, 0.0)

    def sums(self) -> NDArray[np.float64]:
        """(KEPT, parts) running sums over the parts, oldest first: the tops of a stacked plot."""
        return np.cumsum(self._history, axis=1)

    def medians(self) -> dict[str, float]:
        """Of each part over the last pictures that it took part in: a scene at rest is not drawn anew."""
        taken = [column[column > 0] for column in self._history.T]
        return {name: float(np.median(times)) if len(times) else 0.0 for name, times in zip(PARTS, taken, strict=True)}
