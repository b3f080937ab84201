"""Child processes that parse files, used by one test after another."""

from __future__ import annotations

import os
import subprocess
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

from fourd.base.errors import UserError
from fourd.base.processes import isolation
from fourd.base.processes.isolation import ParserProcess

OWN = {name: vars(ParserProcess)[name] for name in ("_start", "__exit__", "close")}
"""The methods of :class:`ParserProcess`, as they are in programs."""


@contextmanager
def shared_parsers() -> Iterator[None]:
    """Keep child processes of :class:`ParserProcess` that have replied to all calls for the next tests. A message about
    an invalid file is a reply, too.

    The suite starts hundreds of them, and each needs about as much time for its imports as most tests need for the
    rest. A child process is used again from the folder in which it was started and with the same limit of its memory.
    """
    pool = _Pool()

    def leave(self: ParserProcess, *exception: object) -> None:
        has_replied = not any(exception) or isinstance(exception[1], UserError)
        if has_replied and self._stop is not None:
            self._stop()
            self._process = self._stop = None
        else:
            self.close()

    def close(self: ParserProcess) -> None:
        if self._stop is not None and self._process is not None:
            self._stop.detach()
            isolation._stop(self._process)
        self._process = self._stop = None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ParserProcess, "_start", lambda self: pool.start(self))
        patch.setattr(ParserProcess, "__exit__", leave)
        patch.setattr(ParserProcess, "close", close)
        yield
    pool.stop()


@dataclass(frozen=True)
class _Pool:
    """Idle child processes, by their working folder and the limit of their memory."""

    idle: dict[tuple[str, int], list[subprocess.Popen[bytes]]] = field(default_factory=dict)

    def start(self, parser: ParserProcess) -> subprocess.Popen[bytes]:
        """Give a parser an idle child process, or start one. The process returns to the pool when the parser is
        deleted."""
        if parser._process is None or parser._process.poll() is not None:
            place = (os.getcwd(), isolation.MAX_BYTES)
            waiting = self.idle.setdefault(place, [])
            parser.close()
            while parser._process is None and waiting:
                process = waiting.pop()
                if process.poll() is None:
                    parser._process = process
            process = OWN["_start"](parser)
            if parser._stop is not None:
                parser._stop.detach()
            parser._stop = weakref.finalize(parser, waiting.append, process)
        return parser._process

    def stop(self) -> None:
        for processes in self.idle.values():
            for process in processes:
                isolation._stop(process)
