"""Deferral of Ctrl-C."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType


class DeferredInterrupt:
    """A context manager. Inside the ``with`` block, the first Ctrl-C only sets :attr:`is_pending`, and the second
    Ctrl-C raises KeyboardInterrupt.

    Signals are deferred only in the main thread, because Python handles signals only in the main thread. If the process
    ignores Ctrl-C or has its own handler for Ctrl-C, the context manager has no effect.
    """

    def __init__(self) -> None:
        self.is_pending = False
        self._is_active = False

    def __enter__(self) -> DeferredInterrupt:
        is_main = threading.current_thread() is threading.main_thread()
        if is_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._handle)
            self._is_active = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_active:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            self._is_active = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.is_pending:
            raise KeyboardInterrupt
        self.is_pending = True
