"""Child processes that parse files, used by one test after another."""

from __future__ import annotations

import os
import subprocess
import weakref
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from fourd.base.processes import isolation
from fourd.base.processes.isolation import ParserProcess


@contextmanager
def shared_parsers() -> Iterator[None]:
    """Keep child processes of :class:`ParserProcess` whose calls have succeeded for the next tests.

    The suite starts hundreds of them, and each needs about as much time for its imports as most tests need for the
    rest. A child process is used again from the folder in which it was started and with the same limit of its memory.
    """
    idle: dict[tuple[str, int], list[subprocess.Popen[bytes]]] = {}
    start, leave = ParserProcess._start, ParserProcess.__exit__

    def start_or_take(self: ParserProcess) -> subprocess.Popen[bytes]:
        waiting = idle.get((os.getcwd(), isolation.MAX_BYTES), [])
        while self._process is None and waiting:
            process = waiting.pop()
            if process.poll() is None:
                self._process, self._stop = process, weakref.finalize(self, isolation._stop, process)
        return start(self)

    def leave_or_keep(self: ParserProcess, *exception: object) -> None:
        if self._process is None or self._stop is None or any(exception):
            return leave(self, *exception)
        self._stop.detach()
        idle.setdefault((os.getcwd(), isolation.MAX_BYTES), []).append(self._process)
        self._process = self._stop = None
        return None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ParserProcess, "_start", start_or_take)
        patch.setattr(ParserProcess, "__exit__", leave_or_keep)
        yield
    for processes in idle.values():
        for process in processes:
            isolation._stop(process)
