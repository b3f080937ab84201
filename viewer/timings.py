"""Measures the time of each part of the work for an image, for the plot in the panel. The parts are listed in PARTS."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

PARTS = ("draw", "style", "panel", "present")
HISTORY = 120
"""Number of images whose times are kept."""
_FEWEST = 3
"""Smallest number of images from which a rate is computed."""
_SLOWEST_SECONDS = 3.0
"""Images at larger intervals do not count as images that are drawn again and again."""


class Timings:
    """The time in milliseconds of each part of the work for an image, for the last HISTORY images."""

    def __init__(self) -> None:
        self._history = np.zeros((HISTORY, len(PARTS)))
        self._current = dict.fromkeys(PARTS, 0.0)
        self._drawn: deque[float] = deque(maxlen=HISTORY)

    def count_image(self, now: float) -> None:
        """Count an image of the scene that was drawn at the time ``now`` in seconds."""
        self._drawn.append(now)

    def images_per_second(self, now: float) -> float:
        """Return the images of the scene that were drawn per second, in the last second before the time ``now``. The
        result is 0 while the scene is not drawn again and again, for example while it is paused."""
        recent = [time for time in self._drawn if now - time < 1.0]
        if len(recent) < _FEWEST:
            recent = list(self._drawn)[-_FEWEST:]
        if len(recent) < _FEWEST:
            return 0.0
        interval = (recent[-1] - recent[0]) / (len(recent) - 1)
        goes_on = now - recent[-1] < max(0.5, 3 * interval)
        return 1 / interval if goes_on and 0 < interval < _SLOWEST_SECONDS else 0.0

    @contextmanager
    def measure(self, part: str) -> Iterator[None]:
        """Measure the duration of a ``with`` block, and add it to the current image's time for the part ``part``."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self._current[part] += 1e3 * (time.perf_counter() - started)

    def move(self, source: str, target: str, seconds: float) -> None:
        """In the times of the current image, subtract ``seconds`` from the part ``source`` and add them to the part
        ``target``. If ``source`` has less time than this, move only the time that it has."""
        moved = min(1e3 * seconds, self._current[source])
        self._current[source] -= moved
        self._current[target] += moved

    def finish_image(self) -> None:
        """Append the times of the current image to the history."""
        self._history = np.roll(self._history, -1, axis=0)
        self._history[-1] = [self._current[name] for name in PARTS]
        self._current = dict.fromkeys(PARTS, 0.0)

    def cumulative(self) -> NDArray[np.float64]:
        """Return cumulative sums of the times over the parts, for a stacked plot.

        The shape is (HISTORY, parts), with the oldest image first.
        """
        return np.cumsum(self._history, axis=1)

    def medians(self) -> dict[str, float]:
        """Return the median time of each part in milliseconds.

        Images in which a part did not run do not count for its median. For example, "draw" does not run for an
        unchanged scene.
        """
        nonzero = [column[column > 0] for column in self._history.T]
        return {
            name: float(np.median(times)) if len(times) else 0.0 for name, times in zip(PARTS, nonzero, strict=True)
        }
