"""Connect the training loop with other programs, which watch the run and send requests to it."""

from __future__ import annotations

import platform
import secrets
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.limits import printable
from fourd.reconstruction.training.live.control import Action, ControlReader
from fourd.reconstruction.training.live.state import MAX_REASON, Phase, TrainingState, training_lock, write_state

CONTROL_SECONDS = 0.5
"""Minimum time in seconds between two reads of the control file."""
STATE_SECONDS = 1.0
"""Minimum time in seconds between two writes of the state file. If the phase changes, the file is written at once."""


@dataclass(frozen=True)
class StepCount:
    """Training progress: completed steps, training time in seconds, and the fraction of the budget that is spent."""

    step: int
    seconds: float
    spent: float


class NoSession:
    """A session without files, with the methods of :class:`LiveSession`. All ranks except rank 0 use it."""

    wanted: Action | None = None

    def look(self) -> None:
        """Do nothing."""

    def answered(self) -> None:
        """Do nothing."""

    def show(self, progress: StepCount, phase: Phase = "training") -> None:
        """Do nothing."""

    def __enter__(self) -> NoSession:
        return self

    def __exit__(self, *exception: object) -> None:
        """Do nothing."""


class LiveSession:
    """A context manager that writes the state of training and reads the requests to it.

    The training loop calls :meth:`show` and :meth:`look` between steps; they do nothing if the last write or read was
    too recent. If the state cannot be written, training continues without it.

    Attributes:
        wanted: the last request that was not yet answered, or None.
    """

    def __init__(self, run: Path, max_steps: int | None, is_held_out: bool, console: Console) -> None:
        self.wanted: Action | None = None
        self._run = run
        self._max_steps = max_steps
        self._is_held_out = is_held_out
        self._console = console
        self._session = secrets.token_hex(8)
        self._progress = StepCount(0, 0.0, 0.0)
        self._phase: Phase = "training"
        self._next_look = self._next_write = 0.0
        self._stack = ExitStack()

    def __enter__(self) -> LiveSession:
        with suppress(OSError):
            self._stack.enter_context(training_lock(self._run))
        # Requests that were written before this session starts belong to earlier sessions.
        self._requests = ControlReader(self._run, self._session)
        return self

    def look(self) -> None:
        """Read a new request, at most every half second."""
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + CONTROL_SECONDS
        try:
            request = self._requests.read()
        except UserError as error:
            self._console.print(f"{error}", style="yellow", soft_wrap=True, markup=False)
            return
        if request is not None:
            self.wanted = request.action

    def answered(self) -> None:
        """Discard the request after it was answered."""
        self.wanted = None

    def show(self, progress: StepCount, phase: Phase = "training") -> None:
        """Write the state, at once if the phase has changed and otherwise at most once per second."""
        self._progress = progress
        now = time.monotonic()
        if phase == self._phase and now < self._next_write:
            return
        self._phase, self._next_write = phase, now + STATE_SECONDS
        self._write()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        reason = ""
        if error is None:
            self._phase = "finished"
        elif isinstance(error, KeyboardInterrupt | SystemExit):
            self._phase = "stopped"
        else:
            self._phase = "failed"
            text = str(error) if isinstance(error, UserError) else type(error).__name__
            reason = printable(text)[:MAX_REASON]
        self._write(reason)
        self._stack.close()

    def _write(self, reason: str = "") -> None:
        step, seconds, spent = self._progress.step, self._progress.seconds, self._progress.spent
        state = TrainingState(
            session=self._session,
            host=platform.node()[:MAX_REASON],
            phase=self._phase,
            step=step,
            seconds=seconds,
            spent=spent,
            max_steps=self._max_steps,
            is_held_out=self._is_held_out,
            updated=time.time(),
            reason=reason,
        )
        with suppress(OSError):
            write_state(self._run, state)
