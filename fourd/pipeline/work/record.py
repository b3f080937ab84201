"""The record of a folder for intermediate results: which stages were started and finished, with which settings, and
which scene the folder belongs to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from fourd.base.files import write_text_atomically
from fourd.base.json_file import decode_json
from fourd.base.limits import read_json
from fourd.pipeline.stage import StageState

VERSION = 2
STARTED = " started"
"""In records of earlier versions, the suffix of the name under which the key of a started stage is stored."""
RUN_STAGES = ("adjust", "carve", "points", "background", "segments")
"""Stages, besides those that train, that write the run. Records of earlier versions do not have this information."""
UNKNOWN = "made by an earlier version of fourd, whose settings are not recorded"
MAX_CHANGES = 6
"""Maximum number of changes that a message lists."""


@dataclass(frozen=True)
class StageEntry:
    """What is recorded about a stage.

    Attributes:
        started: key with which the stage was last started.
        finished: key with which the stage was finished, or None if it did not finish since it was last started.
        place: name of the folder, inside the folder for intermediate results, to which the stage writes. None if it
            writes elsewhere, or if an earlier version of fourd made the entry.
        state: settings and inputs with which the stage was last started, or None if an earlier version of fourd made
            the entry.
    """

    started: str | None = None
    finished: str | None = None
    place: str | None = None
    state: StageState | None = None

    def changes(self, state: StageState) -> list[str]:
        """Describe how ``state`` differs from the recorded state. Settings come first, then inputs, then stages."""
        old = self.state
        if old is None:
            return [UNKNOWN]
        changed = self.changed_settings(state.settings)
        if set(old.inputs) != set(state.inputs):
            before, after = (", ".join(sorted(set(a) - set(b))) or "none" for a, b in _pairs(old.inputs, state.inputs))
            changed.append(f"input: {before} -> {after}")
        same = set(old.inputs) & set(state.inputs)
        changed += [f"files of {path} have changed" for path in sorted(same) if old.inputs[path] != state.inputs[path]]
        if not changed:
            names = [name for name, key in state.before.items() if old.before.get(name) != key]
            changed = [f"the result of stage {name} has changed" for name in names]
        return changed or ["it depends on other stages than before"]

    def changed_settings(self, settings: Mapping[str, str]) -> list[str]:
        """Describe how ``settings`` differ from the recorded settings. The result is empty if none are recorded."""
        old = {} if self.state is None else self.state.settings
        return [
            f"{_title(name)}: {old.get(name, 'not known')} -> {value}"
            for name, value in settings.items()
            if old and old.get(name) != value
        ]


@dataclass(frozen=True)
class Record:
    """The content of a record file.

    Attributes:
        scene: the scene that the folder belongs to: a URL, or a path relative to the parent of the folder. None if an
            earlier version of fourd made the record.
        stages: the entry of each stage, by its name.
        kept: for each folder that was kept when settings changed, such as ``run.1``, the entries of the stages that
            wrote it.
    """

    scene: str | None = None
    stages: Mapping[str, StageEntry] = field(default_factory=dict)
    kept: Mapping[str, Mapping[str, StageEntry]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path | None) -> Record:
        """Read a record file. If it is missing or damaged, return an empty record, so that all stages run."""
        if path is None:
            return cls()
        try:
            content = read_json(path)
            if isinstance(content, dict) and content.get("version") != VERSION:
                return cls(stages=_earlier(content))
            return decode_json(content, cls)
        except (FileNotFoundError, ValueError):
            return cls()

    def write(self, path: Path) -> None:
        """Write the record to a file atomically."""
        write_text_atomically(path, json.dumps({"version": VERSION, **asdict(self)}, indent=1) + "\n")

    def entry(self, name: str) -> StageEntry:
        """Return the entry of a stage. If there is none, all its attributes are None."""
        return self.stages.get(name, StageEntry())

    def with_entries(self, changes: Mapping[str, StageEntry | None]) -> Record:
        """Return a record with changed entries of stages. An entry whose new value is None is removed."""
        entries: dict[str, StageEntry | None] = {**self.stages, **changes}
        return replace(self, stages={name: entry for name, entry in entries.items() if entry is not None})


def shown_changes(changes: list[str]) -> str:
    """Join descriptions of changes, each once. Only the first MAX_CHANGES are listed."""
    known = list(dict.fromkeys(changes))
    more = len(known) - MAX_CHANGES
    return "; ".join(known[:MAX_CHANGES]) + (f"; and {more} more" if more > 0 else "")


def _title(name: str) -> str:
    """Convert the dotted name of a setting to words. The settings in ``selection`` are known without this prefix."""
    return name.removeprefix("selection.").replace("_", " ")


def _pairs(old: Mapping[str, str], new: Mapping[str, str]) -> tuple[tuple[Mapping[str, str], Mapping[str, str]], ...]:
    return (old, new), (new, old)


def _earlier(content: Mapping[str, Any]) -> dict[str, StageEntry]:
    """Read the entries of a record that an earlier version of fourd wrote: one key for each finished stage, and one for
    each started stage."""
    keys = {str(name): str(key) for name, key in content.items() if isinstance(key, str)}
    names = {name.removesuffix(STARTED) for name in keys}
    return {
        name: StageEntry(
            keys.get(name + STARTED), keys.get(name), "run" if name in RUN_STAGES or name.startswith("train") else None
        )
        for name in sorted(names)
    }
