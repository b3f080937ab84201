"""The runner executes stages, skips stages that are up to date, and resumes interrupted stages."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fourd.files import write_text_atomically
from fourd.limits import read_json
from fourd.pipeline.stage import Context, Stage

if TYPE_CHECKING:
    # StoredResults is imported only for type checkers, because it imports the packages for training, and the runner
    # must also run without them.
    from fourd.pipeline.stored.results import StoredResults

AnyStage = Stage[Any, Any]
Execute = Callable[[Sequence[AnyStage], Context], Iterator[AnyStage]]
"""Function that runs the work of stages that do not depend on each other, and yields each stage when its outputs are
written."""


def run_here(stages: Sequence[AnyStage], context: Context) -> Iterator[AnyStage]:
    """Run the work of the stages in this process, one after another."""
    for stage in stages:
        stage.run(context)
        yield stage


class Runner:
    """Runs stages in a given order.

    If a record file is given, the runner prints the state of each stage. It skips a stage if its outputs exist and its
    key (see :meth:`Stage.key`) is the same as in the record file. Before it starts a stage whose key has changed, it
    removes the files that were written with the old key. Without a record file, the runner executes every stage and
    prints nothing; the stages themselves detect and keep finished files.
    """

    def __init__(
        self,
        context: Context,
        record: Path | None = None,
        execute: Execute = run_here,
        *,
        is_parallel: bool = False,
        stored: StoredResults | None = None,
    ) -> None:
        """Create a runner.

        Args:
            context: console, and number of processes for the stages' work.
            record: JSON file with the key of each started and each finished stage, which is written atomically after
                each change.
            execute: function that runs the work of stages, for example in other processes or on a cluster.
            is_parallel: whether ``execute`` runs several stages at the same time.
            stored: results in an object store, which replace the record file and the local results.
        """
        self._context = context
        self._record = record
        self._execute = execute if stored is None else stored.execute(execute)
        self._stored = stored
        self._is_parallel = is_parallel
        self._known = _read_record(record)
        self._keys: dict[str, str] = {}

    @property
    def is_stored(self) -> bool:
        """Whether the results are in an object store."""
        return self._stored is not None

    def run(self, stages: Sequence[AnyStage]) -> None:
        """Run ``stages`` in the given order. Each stage must come after the stages that it depends on."""
        for group in _split(stages) if self._is_parallel else [[stage] for stage in stages]:
            due = [stage for stage in group if self._start(stage)]
            for stage in self._execute(due, self._context) if due else ():
                self._write({stage.name: self._keys[stage.name]})
                self._report(f"{stage.name}: finished{self._result(stage)}")
            if self._stored is not None:
                # The results are copied to this machine, because the next stages and their keys depend on these files.
                self._stored.copy()

    def _start(self, stage: AnyStage) -> bool:
        """Return whether the work of the stage must run. If it must, first remove the files that were written with an
        older key."""
        if self._stored is not None:
            return self._start_stored(stage, self._stored)
        key = self._keys[stage.name] = stage.key(self._keys)
        if self._known.get(stage.name) == key and stage.is_finished():
            self._report(f"{stage.name}: up to date{self._result(stage)}")
            return False
        if self._record is not None and self._known.get(_started(stage)) != key:
            # The keys are deleted before the files, so that no key matches the remaining files if the removal is
            # interrupted.
            self._write({stage.name: None, _started(stage): None})
            for leftovers in stage.leftovers:
                leftovers.remove()
        self._write({stage.name: None, _started(stage): key})
        self._report(f"{stage.name}: running")
        return True

    def _start_stored(self, stage: AnyStage, stored: StoredResults) -> bool:
        """Return whether the work of the stage must run. The machine that runs the work removes the files that were
        written with an older key."""
        key = self._keys[stage.name] = stage.key(self._keys, stored.root)
        is_due = not stored.is_finished(stage, key)
        self._report(f"{stage.name}: {'running' if is_due else 'up to date'}")
        return is_due

    def _write(self, changes: Mapping[str, str | None]) -> None:
        """Change entries of the record file. An entry whose new value is None is removed."""
        if self._record is None:
            return
        entries = {**self._known, **changes}
        self._known = {name: key for name, key in entries.items() if key is not None}
        write_text_atomically(self._record, json.dumps(self._known, indent=1) + "\n")

    def _result(self, stage: AnyStage) -> str:
        return f" ({stage.outputs[0]})" if stage.outputs and self._stored is None else ""

    def _report(self, line: str) -> None:
        if self._record is not None or self._stored is not None:
            self._context.console.print(line, soft_wrap=True, markup=False)


def _split(stages: Sequence[AnyStage]) -> list[list[AnyStage]]:
    """Split stages into groups of consecutive stages that can run at the same time."""
    groups: list[list[AnyStage]] = []
    for stage in stages:
        before = groups[-1] if groups else []
        names = {other.name for other in before}
        if before and stage.is_parallel and before[0].is_parallel and names.isdisjoint(stage.after):
            before.append(stage)
        else:
            groups.append([stage])
    return groups


def _started(stage: AnyStage) -> str:
    """Return the name of the entry that stores the key of a started stage in the record file."""
    return f"{stage.name} started"


def _read_record(record: Path | None) -> dict[str, str]:
    """Read the keys from a record file. If it is missing or damaged, return no keys, so that all stages run."""
    if record is None:
        return {}
    try:
        content = read_json(record)
    except (FileNotFoundError, ValueError):
        return {}
    return {str(name): str(key) for name, key in content.items()} if isinstance(content, dict) else {}
