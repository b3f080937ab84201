"""Requests of other programs to a training process. The run's file ``live/control.json`` contains the last request."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.json_file import read_json_as
from fourd.reconstruction.training.run_layout import LIVE

CONTROL_NAME = "control.json"
MAX_CONTROL_BYTES = 1 << 12

Action = Literal["pause", "resume", "save", "stop"]
ACTIONS: tuple[Action, ...] = get_args(Action)


@dataclass(frozen=True)
class ControlRequest:
    """A request to a training process.

    Attributes:
        session: the training session to which the request is addressed; see
            :class:`fourd.reconstruction.training.live.state.TrainingState`. Other sessions of the same run ignore the
            request.
        action: what training is asked to do: ``pause`` saves a checkpoint and waits, ``resume`` continues after a
            pause, ``save`` saves a checkpoint and continues, and ``stop`` saves a checkpoint and ends.
    """

    session: str
    action: Action


def write_request(run: Path, request: ControlRequest) -> None:
    """Write a request to a run. The new request replaces the last one. Raises OSError if the run is not writable."""
    content = json.dumps({"session": request.session, "action": request.action})
    write_text_atomically(run / LIVE / CONTROL_NAME, content)


class ControlReader:
    """Reads new requests to one training session."""

    def __init__(self, run: Path, session: str) -> None:
        self._path = run / LIVE / CONTROL_NAME
        self._session = session
        self._seen = self._version()

    def read(self) -> ControlRequest | None:
        """Return the request to this session that was written since the last call, or None if there is none.

        If the file has not changed, this method only queries the file's status, which takes some microseconds.

        Raises:
            UserError: if the file has changed and is not a valid request. The next call ignores the invalid file.
        """
        version = self._version()
        if version == self._seen:
            return None
        self._seen = version
        if version is None:
            return None
        try:
            request = read_json_as(self._path, ControlRequest, MAX_CONTROL_BYTES)
        except (OSError, ValueError) as error:
            raise UserError(
                f"{self._path}: expected a session and one of {', '.join(ACTIONS)}, got other content ({error}); use "
                "the buttons of fourd serve"
            ) from error
        return request if request.session == self._session else None

    def _version(self) -> tuple[int, int, int] | None:
        """Return values that change when the control file is replaced, or None if there is no control file."""
        try:
            status = os.stat(self._path)
        except OSError:
            return None
        return status.st_ino, status.st_mtime_ns, status.st_size
