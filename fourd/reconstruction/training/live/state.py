"""The state of a training process: the run's file ``live/state.json``, and a lock on the folder ``live/``."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from fourd.base.errors import UserError
from fourd.base.files import UNFINISHED, try_lock
from fourd.base.json_file import decode_json
from fourd.base.limits import read_json
from fourd.reconstruction.training.run_layout import LIVE

if sys.platform != "win32":
    import fcntl

STATE_NAME = "state.json"
MAX_STATE_BYTES = 1 << 14
SILENT_SECONDS = 60.0
"""A training process is assumed to have ended if the last state that it wrote is older than this number of seconds. The
age is used only if the lock of the process cannot be tested, because the process runs on another machine or the system
has no locks."""

MAX_REASON = 500
"""Maximum number of characters of each text in a :class:`TrainingState`."""
Phase = Literal["training", "paused", "finished", "stopped", "failed"]
Text = Annotated[str, Meta(max_length=MAX_REASON)]
Count = Annotated[int, Meta(ge=0, lt=1 << 53)]
Seconds = Annotated[float, Meta(ge=0, lt=1e30)]


@dataclass(frozen=True)
class TrainingState:
    """The state of a training process.

    Attributes:
        session: identifies one call of the training loop. A resumed run has another session.
        host: name of the machine that trains.
        phase: the current activity of training, or how it ended.
        step: number of completed steps.
        seconds: training time in seconds, without pauses.
        spent: fraction of the budget that is spent, in [0, 1].
        max_steps: number of steps of the budget, or None.
        is_held_out: whether the validation views are held out from training.
        updated: time of this state, in seconds since 1970.
        reason: the error if training failed, otherwise an empty text.
    """

    session: Text
    host: Text
    phase: Phase
    step: Count
    seconds: Seconds
    spent: Annotated[float, Meta(ge=0, le=1)]
    max_steps: Count | None
    is_held_out: bool
    updated: Seconds
    reason: Text = ""


def write_state(run: Path, state: TrainingState) -> None:
    """Replace the state file of a run.

    The file is replaced atomically but not synced to the disk. Syncing could take longer than a training step, and the
    state is not needed after a power failure.
    """
    path = run / LIVE / STATE_NAME
    temporary = path.with_name(f"{UNFINISHED}{STATE_NAME}")
    temporary.write_text(json.dumps(asdict(state)), encoding="utf-8")
    os.replace(temporary, path)


def read_state(run: Path) -> TrainingState | None:
    """Read the last state of a run. Returns None if the state file is missing or damaged."""
    try:
        content = read_json(run / LIVE / STATE_NAME, MAX_STATE_BYTES)
        state = decode_json(content, TrainingState)
    except (OSError, ValueError, UserError):
        return None
    return state if content.keys() == vars(state).keys() else None


@contextmanager
def training_lock(run: Path) -> Iterator[None]:
    """Hold a lock until the ``with`` block or the process ends. The lock shows other processes that this process
    trains the run.

    The lock is a shared flock on the folder ``live/``, which is created if it is missing. It does not prevent a second
    process from training the same run. Another lock, on the run's own folder, prevents this; see
    :func:`fourd.base.processes.locked_folder`. On Windows, nothing is locked.
    """
    folder = run / LIVE
    folder.mkdir(parents=True, exist_ok=True)
    if sys.platform == "win32":
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        # The call may block for some microseconds while another process tests the lock by holding it exclusively.
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield
    finally:
        os.close(descriptor)


def is_training(run: Path, state: TrainingState) -> bool:
    """Return true if the process that wrote ``state`` still trains the run or has paused training."""
    if state.phase not in ("training", "paused"):
        return False
    # On shared storage, a machine may not see the locks of other machines.
    locked = _is_locked(run / LIVE) if state.host == platform.node() else None
    return abs(time.time() - state.updated) < SILENT_SECONDS if locked is None else locked


def _is_locked(folder: Path) -> bool | None:
    """Return true if a training process holds the lock on ``folder``, or None if the system has no locks."""
    if sys.platform == "win32":
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return False
    try:
        is_free = try_lock(descriptor)
    finally:
        os.close(descriptor)
    return None if is_free is None else not is_free
