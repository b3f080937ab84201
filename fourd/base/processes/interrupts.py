"""Deferral of Ctrl-C, and termination by the signal SIGTERM."""

from __future__ import annotations

import signal
import socket
import threading
from types import FrameType, TracebackType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def handle_termination() -> None:
    """Make SIGTERM raise KeyboardInterrupt, as Ctrl-C does, so that commands remove unfinished files and training saves
    a checkpoint when a batch system or a container ends them.

    Call this function again after imports: some C++ libraries replace the handler of SIGTERM when they are loaded.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)


class DeferredInterrupt:
    """A context manager. Inside the ``with`` block, the first Ctrl-C only sets :attr:`is_pending`, and the second
    Ctrl-C raises KeyboardInterrupt. SIGTERM is deferred in the same way after a call of :func:`handle_termination`.

    Outside the main thread, nothing is deferred, because Python handles signals only in the main thread. A signal is
    deferred only if its handler at the start of the block is ``signal.default_int_handler``, which raises
    KeyboardInterrupt. Signals that are ignored or have another handler are not affected.
    """

    def __init__(self) -> None:
        self.is_pending = False
        self._deferred: list[signal.Signals] = []

    def __enter__(self) -> DeferredInterrupt:
        is_main = threading.current_thread() is threading.main_thread()
        for number in SIGNALS if is_main else ():
            if signal.getsignal(number) is signal.default_int_handler:
                signal.signal(number, self._handle)
                self._deferred.append(number)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number in self._deferred:
            signal.signal(number, signal.default_int_handler)
        self._deferred.clear()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.is_pending:
            raise KeyboardInterrupt
        self.is_pending = True


class ReceivedSignals:
    """A context manager that knows whether one of SIGNALS arrived inside the ``with`` block, whatever became of it.

    The KeyboardInterrupt that a signal raises can be lost: C++ code that calls Python, for example torch's, replaces it
    by an error of its own. Outside the main thread, no signal is noticed.
    """

    def __enter__(self) -> ReceivedSignals:
        self._is_main = threading.current_thread() is threading.main_thread()
        if self._is_main:
            self._reading, self._writing = socket.socketpair()
            for end in (self._reading, self._writing):
                end.setblocking(False)
            self._before = signal.set_wakeup_fd(self._writing.fileno(), warn_on_full_buffer=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_main:
            signal.set_wakeup_fd(self._before)
            self._reading.close()
            self._writing.close()

    def any(self) -> bool:
        """Return whether a signal has arrived since the last call."""
        if not self._is_main:
            return False
        try:
            received = self._reading.recv(4096)
        except BlockingIOError:
            return False
        return any(number in received for number in SIGNALS)
