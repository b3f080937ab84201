"""The folder of a capture's mattes, and the file that records with which inputs and settings the mattes were made."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fourd.base.files import UNFINISHED, remove_unfinished, write_text_atomically
from fourd.base.json_file import read_json_as
from fourd.recording.capture.layout import DERIVED, MATTES

VERSION = 8
STATE = "mattes.json"
MODEL_NAME = "subject.npz"
SHEET = DERIVED / "mattes.png"
NEW = "new_mattes"
"""Name of the folder in which new mattes are collected if the inputs or settings have changed since the existing mattes
were made. It lies beside the folder of the existing mattes."""
METHODS = ("motion", "chroma", "rvm", "onnx", "masks")


@dataclass(frozen=True)
class MatteState:
    """Content of the file STATE.

    Attributes:
        key: hash of the inputs and settings of the mattes in the folder MATTES, or None if the hash is unknown.
        model: key of the learned models, a hash of their inputs and settings.
        new: key of the mattes in the folder NEW, or None if this folder has no mattes.
        chosen: the matting method (one of METHODS) if the user chose the settings of the mattes, otherwise None. A user
            chooses settings through the options of ``fourd matte``.
        inputs: hash of the capture's files at the time when the user chose the settings, or None if ``chosen`` is None.
    """

    key: str | None = None
    model: str | None = None
    new: str | None = None
    chosen: str | None = None
    inputs: str | None = None

    @classmethod
    def read(cls, capture: Path) -> MatteState:
        """Read the state of a capture. If the file is missing or damaged, all fields are None."""
        try:
            state = read_json_as(capture / DERIVED / STATE, cls)
        except (OSError, ValueError):
            return cls()
        return state if state.chosen in METHODS else replace(state, chosen=None)

    def write(self, capture: Path) -> None:
        """Write the state of a capture atomically. The fields ``new``, ``chosen`` and ``inputs`` are left out if they
        are None."""
        fields = {"version": VERSION, "key": self.key, "model": self.model}
        optional = {"new": self.new, "chosen": self.chosen, "inputs": self.inputs}
        fields |= {name: value for name, value in optional.items() if value is not None}
        write_text_atomically(capture / DERIVED / STATE, json.dumps(fields) + "\n")


@dataclass(frozen=True)
class MatteOutput:
    """The folder MATTES of a capture, and the keys (hashes of inputs and settings) that its mattes and models should
    have.

    Outdated mattes are replaced only when all new mattes are written, so that an error or an interruption loses no
    mattes. Incomplete new mattes are in the folder NEW.
    """

    capture: Path
    key: str
    model_key: str

    @property
    def folder(self) -> Path:
        """The folder of the mattes."""
        return self.capture / MATTES

    @property
    def model(self) -> Path:
        """The file of the models."""
        return self.capture / DERIVED / MODEL_NAME

    @property
    def _new(self) -> Path:
        return self.capture / DERIVED / NEW

    def prepare(self) -> None:
        """Delete models whose key is not ``model_key``, and unfinished files of killed processes.

        The models are kept if only the images in which the user paints corrections have changed, because ``model_key``
        does not depend on these images.
        """
        state = MatteState.read(self.capture)
        remove_unfinished(self.folder.parent)
        remove_unfinished(self.folder, deep=True)
        remove_unfinished(self._new, deep=True)
        if state.key is None and state.new == self.key and self.folder.exists() and not self._new.exists():
            # An earlier process was killed after the new mattes had replaced the old ones, but before it wrote the new
            # key.
            replace(state, key=self.key, new=None).write(self.capture)
        elif state.model != self.model_key:
            self.model.unlink(missing_ok=True)
            replace(state, model=self.model_key).write(self.capture)

    def missing(self, names: Sequence[str], frames: Sequence[str]) -> list[int]:
        """Return the indices of the ``frames`` for which at least one of the cameras ``names`` has no matte with the
        current key."""
        state = MatteState.read(self.capture)
        if self.key not in (state.key, state.new):
            return list(range(len(frames)))
        folder = self.folder if state.key == self.key else self._new
        return [
            index
            for index, frame in enumerate(frames)
            if not all((folder / name / f"{frame}.png").exists() for name in names)
        ]

    def start(self) -> Path:
        """Return the folder to which mattes are written. All mattes in it have the current key."""
        state = MatteState.read(self.capture)
        if state.key == self.key:
            return self.folder
        if state.new == self.key and self._new.exists():
            return self._new
        if any(self.folder.glob("*/*")):
            shutil.rmtree(self._new, ignore_errors=True)
            replace(state, new=self.key).write(self.capture)
            return self._new
        self._remove_sheet()
        MatteState(self.key, self.model_key).write(self.capture)
        return self.folder

    def finish(self) -> None:
        """Replace the old mattes by the new ones, which must all have been written."""
        state = MatteState.read(self.capture)
        if state.key == self.key or state.new != self.key:
            shutil.rmtree(self._new, ignore_errors=True)
            return
        # While the folders are exchanged, the stored key is None, so that no mattes count as valid.
        MatteState(None, self.model_key, self.key).write(self.capture)
        self._remove_sheet()
        old = self.folder.with_name(f"{UNFINISHED}{self.folder.name}")
        if self.folder.exists():
            self.folder.rename(old)
        self._new.rename(self.folder)
        MatteState(self.key, self.model_key).write(self.capture)
        shutil.rmtree(old, ignore_errors=True)

    def _remove_sheet(self) -> None:
        (self.capture / SHEET).unlink(missing_ok=True)
