"""Measures how long the GPU works on a group of commands."""

from __future__ import annotations

from types import TracebackType

import numpy as np
from OpenGL import GL


class GPUTimer:
    """Measures the GPU time of the commands in ``with`` blocks.

    A result is read only once it is available, so that the program never waits for the GPU. The ``with`` blocks of two
    timers must not overlap. This class calls OpenGL directly, because the queries of moderngl cannot be deleted.
    """

    def __init__(self) -> None:
        # Two queries are needed, because the GPU may report the time of one block only after the next has started.
        self._queries = [int(query) for query in np.asarray(GL.glGenQueries(2)).ravel()]
        self._pending: list[int] = []
        self._seconds = 0.0

    @property
    def seconds(self) -> float:
        """Duration of the last block whose result is known, in seconds. The duration is 0 before the first result."""
        while self._pending and _value(self._pending[0], GL.GL_QUERY_RESULT_AVAILABLE):
            self._seconds = 1e-9 * _value(self._pending.pop(0), GL.GL_QUERY_RESULT)
        return self._seconds

    def __enter__(self) -> GPUTimer:
        if len(self._pending) == len(self._queries):
            self._pending.pop(0)  # drop the oldest query, whose result is not available yet
        free = next(query for query in self._queries if query not in self._pending)
        GL.glBeginQuery(GL.GL_TIME_ELAPSED, free)
        self._pending.append(free)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        GL.glEndQuery(GL.GL_TIME_ELAPSED)

    def release(self) -> None:
        """Delete the queries."""
        GL.glDeleteQueries(len(self._queries), self._queries)
        self._queries, self._pending = [], []


def _value(query: int, name: int) -> int:
    # PyOpenGL cannot call the 64-bit version of this function, because it has no array type for the result. 32 bits are
    # enough for times of up to 4 s in nanoseconds.
    return int(np.asarray(GL.glGetQueryObjectuiv(query, name)).ravel()[0])
