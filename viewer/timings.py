"""Time spent per stage of an image, for the panel's plot."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

STAGES = ("draw", "panel", "present")
HISTORY = 120
"""Count of images kept."""


class Timings:
    """Milliseconds per stage of the last images."""

    def __init__(self) -> None:
        self._history = np.zeros((HISTORY, len(STAGES)))
        self._current = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Add the duration of the block to a stage of the current image."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self._current[stage] += 1e3 * (time.perf_counter() - started)

    def finish_image(self) -> None:
        """Append the current image to the history."""
        self._history = np.roll(self._history, -1, axis=0)
        self._history[-1] = [self._current[name] for name in STAGES]
        self._current = dict.fromkeys(STAGES, 0.0)

    def cumulative(self) -> NDArray[np.float64]:
        """(HISTORY, stages) cumulative sums over the stages, oldest image first, for a stacked plot."""
        return np.cumsum(self._history, axis=1)

    def medians(self) -> dict[str, float]:
        """Median milliseconds per stage over the images that include it; an unchanged scene is not drawn again."""
        nonzero = [column[column > 0] for column in self._history.T]
        return {
            name: float(np.median(times)) if len(times) else 0.0 for name, times in zip(STAGES, nonzero, strict=True)
        }
