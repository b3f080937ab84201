"""Calls of a function at intervals, in a thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def called_every(seconds: float, action: Callable[[], object]) -> Iterator[None]:
    """Context manager: while its block runs, a thread calls ``action`` and waits ``seconds`` before each call. At the
    end of the block, a running call is completed."""
    stopped = threading.Event()

    def repeat() -> None:
        while not stopped.wait(seconds):
            action()

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()
