"""Calls of a function at intervals, in a thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def called_every(seconds: float, action: Callable[[], object]) -> Iterator[None]:
    """Call ``action`` in a thread while the ``with`` block runs, and wait ``seconds`` before each call. If a call is
    running when the block ends, wait until it returns."""
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
