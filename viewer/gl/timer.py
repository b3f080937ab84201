"""Measures how long the GPU works on a group of commands."""

from __future__ import annotations

from types import TracebackType

from fourd.viewer import gl_functions


class GPUTimer:
    """Measures the GPU time of the commands in ``with`` blocks.

    A result is read only once it is available, so that the program never waits for the GPU. The ``with`` blocks of two
    timers must not overlap. This class calls OpenGL directly, because the queries of moderngl cannot be deleted.
    """

    def __init__(self) -> None:
        # Two queries are needed, because the GPU may report the time of one block only after the next has started.
        self._queries = gl_functions.make_queries(2)
        self._pending: list[int] = []
        self._seconds = 0.0

    @property
    def seconds(self) -> float:
        """Duration of the last block whose result is known, in seconds. The duration is 0 before the first result."""
        while self._pending and gl_functions.query_value(self._pending[0], gl_functions.QUERY_RESULT_AVAILABLE):
            self._seconds = 1e-9 * gl_functions.query_value(self._pending.pop(0), gl_functions.QUERY_RESULT)
        return self._seconds

    def __enter__(self) -> GPUTimer:
        if len(self._pending) == len(self._queries):
            self._pending.pop(0)  # drop the oldest query, whose result is not available yet
        free = next(query for query in self._queries if query not in self._pending)
        gl_functions.begin_query(gl_functions.TIME_ELAPSED, free)
        self._pending.append(free)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        gl_functions.end_query(gl_functions.TIME_ELAPSED)

    def release(self) -> None:
        """Delete the queries."""
        gl_functions.delete_queries(self._queries)
        self._queries, self._pending = [], []
