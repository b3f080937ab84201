"""The runner executes stages, skips stages that are up to date, and resumes interrupted stages."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fourd.files import write_text_atomically
from fourd.limits import read_json
from fourd.pipeline.stage import Context, Stage

AnyStage = Stage[Any, Any]
Execute = Callable[[AnyStage, Context], None]


def run_here(stage: AnyStage, context: Context) -> None:
    """Execute the work of a stage in this process."""
    stage.run(context)


class Runner:
    """Runs stages in a given order.

    If a record file is given, the runner prints the state of each stage. The runner skips a stage whose key is
    unchanged and whose outputs exist. Before the runner starts a stage whose key has changed, it removes the files that
    were written with the old key. If no record file is given, the runner executes every stage and prints nothing. The
    stages themselves then detect and keep finished files.
    """

    def __init__(self, context: Context, record: Path | None = None, execute: Execute = run_here) -> None:
        """Create a runner.

        Args:
            context: console, and number of processes for the stages' work.
            record: JSON file with the key of each started and each finished stage. The runner writes this file
                atomically after each change.
            execute: function that runs the work of one stage. The function must return after the outputs were written.
                To execute stages in other processes or on a cluster, pass another function.
        """
        self._context = context
        self._record = record
        self._execute = execute
        self._known = _read_record(record)
        self._keys: dict[str, str] = {}

    def run(self, stages: Sequence[AnyStage]) -> None:
        """Run ``stages`` in the given order. Each stage must come after the stages that it depends on."""
        for stage in stages:
            self._run_stage(stage)

    def _run_stage(self, stage: AnyStage) -> None:
        key = self._keys[stage.name] = stage.key(self._keys)
        result = f" ({stage.outputs[0]})" if stage.outputs else ""
        if self._known.get(stage.name) == key and stage.is_finished():
            self._report(f"{stage.name}: up to date{result}")
            return
        if self._record is not None and self._known.get(_started(stage)) != key:
            # The keys are deleted before the files are removed. If the removal of the files is interrupted, no key then
            # matches the remaining files.
            self._write({stage.name: None, _started(stage): None})
            for leftovers in stage.leftovers:
                leftovers.remove()
        self._write({stage.name: None, _started(stage): key})
        self._report(f"{stage.name}: running")
        self._execute(stage, self._context)
        self._write({stage.name: key})
        self._report(f"{stage.name}: finished{result}")

    def _write(self, changes: Mapping[str, str | None]) -> None:
        """Change entries of the record file. An entry whose new value is None is removed."""
        if self._record is None:
            return
        entries = {**self._known, **changes}
        self._known = {name: key for name, key in entries.items() if key is not None}
        write_text_atomically(self._record, json.dumps(self._known, indent=1) + "\n")

    def _report(self, line: str) -> None:
        if self._record is not None:
            self._context.console.print(line, soft_wrap=True, markup=False)


def _started(stage: AnyStage) -> str:
    """Name of the entry in the record file that stores the key of a started stage."""
    return f"{stage.name} started"


def _read_record(record: Path | None) -> dict[str, str]:
    """Read the keys from a record file. If the file is missing or damaged, no keys are returned, so that all stages
    run."""
    if record is None:
        return {}
    try:
        content = read_json(record)
    except (FileNotFoundError, ValueError):
        return {}
    return {str(name): str(key) for name, key in content.items()} if isinstance(content, dict) else {}
